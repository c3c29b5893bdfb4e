// Web workers for pages that are opened from disk. A browser starts no worker from file://, and the search of this site
// is one. There its script runs in an empty frame of the page instead. Pages on http keep the browser's workers.
if (location.protocol === "file:") {
  window.Worker = class {
    onmessage = null
    onerror = null

    constructor(url) {
      this.frame = document.createElement("iframe")
      this.frame.hidden = true
      document.body.append(this.frame)
      const inside = this.frame.contentWindow
      inside.postMessage = data => setTimeout(() => this.onmessage?.({ data }))
      this.started = new Promise((resolve, reject) => {
        const script = inside.document.createElement("script")
        script.src = new URL(url, location)
        script.onload = () => resolve(inside)
        script.onerror = reject
        inside.document.body.append(script)
      })
      this.started.catch(event => this.onerror?.(event))
    }

    postMessage(data) {
      this.started.then(inside => inside.onmessage({ data }), () => {})
    }

    terminate() {
      this.frame.remove()
    }
  }
}
