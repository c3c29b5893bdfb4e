"""A headless Chromium that tells what it shows and whom it asks; no request of its leaves this machine."""

import base64
import io
import json
import os
import shutil
import subprocess
import tempfile
from socketserver import StreamRequestHandler, ThreadingTCPServer
from threading import Thread
from typing import Any

import matplotlib.image
import numpy as np

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
OWN = {  # hosts that Chromium asks by itself, whatever page it shows
    *("accounts.google.com", "clients2.google.com", "update.googleapis.com", "start.duckduckgo.com"),
    *("content-autofill.googleapis.com", "optimizationguide-pa.googleapis.com"),
}
_FLAGS = (
    *("--headless", "--no-sandbox", "--incognito", "--no-first-run", "--disable-dev-shm-usage"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=640,480", "--remote-debugging-pipe"),
)


class Refused(Exception):
    """Chromium refuses a command."""


class Browser:
    """Opens a page at a time, over the DevTools protocol. Requests to other machines end at a proxy that notes them."""

    def __init__(self) -> None:
        assert PROGRAM is not None
        asked = self._asked = set[str]()

        class Refusal(StreamRequestHandler):
            def handle(self) -> None:  # `CONNECT host:port HTTP/1.1` or `GET http://host/path HTTP/1.1`
                wanted = self.rfile.readline().decode(errors="replace").split()
                asked.update(wanted[1:2])

        self._proxy = ThreadingTCPServer(("127.0.0.1", 0), Refusal)
        self._proxy.daemon_threads = True
        Thread(target=self._proxy.serve_forever, daemon=True).start()
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        proxy = f"--proxy-server=http://127.0.0.1:{self._proxy.server_address[1]}"
        its_input, self._input = os.pipe()
        self._output, its_output = os.pipe()
        as_it_wants = ["bash", "-c", f'exec "$@" 3<&{its_input} 4>&{its_output}', "bash"]  # it reads 3 and writes 4
        self._process = subprocess.Popen(
            [*as_it_wants, PROGRAM, *_FLAGS, f"--user-data-dir={self._profile.name}", proxy],
            pass_fds=(its_input, its_output),
            stderr=subprocess.DEVNULL,
        )
        os.close(its_input)
        os.close(its_output)
        self._unread, self._number, self._session = b"", 0, ""

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._input)
        os.close(self._output)
        self._proxy.shutdown()
        self._proxy.server_close()
        self._profile.cleanup()

    @property
    def asked(self) -> set[str]:
        """Hosts of other machines that were asked so far on behalf of the pages."""
        return {url.rpartition("//")[2].partition("/")[0].partition(":")[0] for url in self._asked} - OWN

    def open(self, url: str) -> None:
        self._session = ""
        target = self._call("Target.createTarget", url=url)["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def screenshot(self) -> Any:
        """What the tab shows, (height, width, 3) bytes of RGB; of a page that is still opening, a black point."""
        try:
            png = base64.b64decode(self._call("Page.captureScreenshot")["data"])
        except Refused:
            return np.zeros((1, 1, 3), dtype=np.uint8)
        return np.round(matplotlib.image.imread(io.BytesIO(png), format="png")[..., :3] * 255).astype(np.uint8)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._input, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self._unread:
                received = os.read(self._output, 1 << 16)
                assert received, "the browser ended"
                self._unread += received
            answer, _, self._unread = self._unread.partition(b"\0")
            if (said := json.loads(answer)).get("id") == self._number:
                if "error" in said:
                    raise Refused(said["error"]["message"])
                result: dict[str, Any] = said["result"]
                return result
