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
      inside.postMessage = message => this.deliver(message, data => this.onmessage?.({ data }))
      this.started = new Promise((resolve, reject) => {
        const script = inside.document.createElement("script")
        script.src = new URL(url, location)
        script.onload = () => resolve(inside)
        script.onerror = reject
        inside.document.body.append(script)
      })
      this.started.catch(event => this.onerror?.(event))
    }

    postMessage(message) {
      this.started.then(inside => this.deliver(message, data => inside.onmessage({ data })), () => {})
    }

    deliver(message, receive) {
      const data = structuredClone(message) // as between threads: no side sees what the other changes
      setTimeout(() => receive(data))
    }

    terminate() {
      this.frame.remove()
    }
  }
}
