"""Chromium judges the web site of the documentation: a word that is typed into its search finds pages."""

import json
import os
import queue
import shutil
import signal
import subprocess
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from tests.commands import printed
from tests.groundstation.browser import CHROMIUM
from tests.polling import DEADLINE_S
from tests.sources import ROOT

FLAGS = ("--headless", "--no-sandbox", "--no-first-run", "--disable-dev-shm-usage", "--user-data-dir=profile")
TYPED = {"krum": "docs/your-aggregation.html", "setpoint": "docs/mavlink.html"}  # and a page that is offered for it
TYPES = """<script>
const pause = () => new Promise(done => setTimeout(done, 20))
const below = root => [...root.querySelectorAll("*")].flatMap(e => e.shadowRoot ? [e, ...below(e.shadowRoot)] : [e])
const all = test => below(document).filter(test)
addEventListener("load", async () => {
  document.querySelector(".md-search__button").click()
  const box = () => all(e => e.role === "combobox")[0]
  while (!box()) await pause()
  for (const [word, page] of Object.entries(TYPED)) {
    const options = () => all(e => e.role === "option" && new URL(e.href).searchParams.get("h") === word)
    const offered = () => options().map(e => new URL(e.href).pathname.slice(1))
    box().value = word
    box().dispatchEvent(new Event("input", { bubbles: true, composed: true }))
    while (!offered().includes(page)) await pause()
    await fetch("/offered", { method: "POST", body: JSON.stringify([word, offered()]) })
  }
})
</script></body>"""


@pytest.mark.xdist_group("site")
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")
def test_words_that_are_typed_into_the_search_find_their_pages(tmp_path: Path) -> None:
    printed("make", "docs", cwd=ROOT, timeout=280.0)  # the first time it installs what builds the site
    site = tmp_path / "site"
    shutil.copytree(ROOT / "site", site)
    front = (site / "index.html").read_text(encoding="utf-8")
    (site / "typing.html").write_text(front.replace("</body>", TYPES.replace("TYPED", json.dumps(TYPED))))
    offered: queue.Queue[tuple[str, list[str]]] = queue.Queue()

    class Handler(SimpleHTTPRequestHandler):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments, directory=str(site))

        def do_POST(self) -> None:
            offered.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        line = [CHROMIUM, *FLAGS, f"http://127.0.0.1:{server.server_port}/typing.html"]
        browser = subprocess.Popen(line, cwd=tmp_path, stderr=subprocess.DEVNULL, start_new_session=True)
        try:
            for word in TYPED:  # raises queue.Empty where the page is not offered in time
                typed, pages = offered.get(timeout=DEADLINE_S)
                assert typed == word
                assert all((site / found).is_file() for found in pages)
        finally:
            os.killpg(browser.pid, signal.SIGKILL)
            browser.wait(DEADLINE_S)
            server.shutdown()
