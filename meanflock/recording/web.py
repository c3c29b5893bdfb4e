"""Rerun's web viewer on a page for browsers of this machine, which may connect to the recording and to nothing else.

By itself the viewer reports its use, asks for newer versions and loads fonts from elsewhere. The page's
Content-Security-Policy makes browsers refuse that; links that open connections beside the policy are removed.
"""

import base64
import hashlib
import io
import re
import shutil
import time
import urllib.parse
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import BinaryIO

from meanflock.net.process import Interrupted
from meanflock.recording.viewer import LOOPBACK, web_viewer_files

_KINDS = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
_RECORDING = "/recording.rrd"
_HOSTS = ("127.0.0.1", "localhost")  # another name may be that of a web site that its owner points at this machine
_OUTSIDE_LINK = re.compile(rb"<link\b[^>]*https?://[^>]*>")
_INLINE_SCRIPT = re.compile(rb"<script>(.*?)</script>", re.DOTALL)


class WebPage(ThreadingHTTPServer):
    """Serves one recording, finished or live, on a free port of loopback while its context is entered."""

    daemon_threads = True

    def __init__(self, recording: Path | str = "") -> None:
        """`recording`: a file, or the URL of a live recording; the page shows the one that is set when a browser comes.

        Raises RunFailed if Rerun's program does not start.
        """
        self.recording = recording
        self.files = web_viewer_files(_KINDS)
        self.files["/"] = _OUTSIDE_LINK.sub(b"", self.files["/"])
        super().__init__((LOOPBACK, 0), _Request)
        self.url = f"http://{LOOPBACK}:{self.server_port}/"

    def __enter__(self) -> "WebPage":
        Thread(target=self.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self.server_close()

    def source(self, host: str) -> str:
        """The URL from which the page loads the recording, for a browser that calls this server `host`."""
        return f"http://{host}{_RECORDING}" if isinstance(self.recording, Path) else self.recording

    def policy(self) -> str:
        """The Content-Security-Policy of the page."""
        scripts = (hashlib.sha256(script).digest() for script in _INLINE_SCRIPT.findall(self.files["/"]))
        inline = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in scripts)
        live = "" if isinstance(self.recording, Path) else f" http://{urllib.parse.urlsplit(self.recording).netloc}"
        return (
            f"default-src 'none'; script-src 'self' 'wasm-unsafe-eval' {inline}; style-src 'unsafe-inline'; "
            f"img-src 'self'; connect-src 'self'{live}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )

    def attend(self) -> None:
        """Serves until Ctrl-C."""
        with Interrupted() as interrupted:
            while not interrupted:
                time.sleep(0.2)


class _Request(BaseHTTPRequestHandler):
    server: WebPage

    def do_GET(self) -> None:
        host = self.headers.get("Host", "")
        asked = urllib.parse.urlsplit(self.path)
        recording = self.server.recording
        if urllib.parse.urlsplit(f"//{host}").hostname not in _HOSTS:
            self.send_error(HTTPStatus.FORBIDDEN)
        elif asked.path == _RECORDING and isinstance(recording, Path):
            with recording.open("rb") as file:
                self._send(file, recording.stat().st_size, "application/octet-stream")
        elif self.path == "/":
            shown = urllib.parse.urlencode({"url": self.server.source(host), "theme": "dark"})
            self.send_response(HTTPStatus.SEE_OTHER)
            self.send_header("Location", f"/?{shown}")
            self.end_headers()
        elif asked.path in self.server.files:
            content = self.server.files[asked.path]
            self._send(io.BytesIO(content), len(content), _KINDS[asked.path])
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _send(self, content: BinaryIO, size: int, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        self.send_header("Content-Security-Policy", self.server.policy())
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        shutil.copyfileobj(content, self.wfile)

    def log_message(self, *_: object) -> None:
        """Requests are not logged."""
