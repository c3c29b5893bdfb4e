"""Chromium without a display, which shows a page for as long as a test wants, and is photographed over a pipe."""

import base64
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, Self

from tests.polling import DEADLINE_S

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_FLAGS = (
    *("--headless", "--no-sandbox", "--incognito", "--no-first-run", "--disable-dev-shm-usage"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=640,480"),
    *("--proxy-server=http://127.0.0.1:9", "--user-data-dir=profile"),  # no proxy: nothing leaves this machine
    *("--log-net-log=net.json", "--remote-debugging-pipe"),
)
# The hosts of what a page asks for; Chromium itself asks for more.
_HOSTS = re.compile(r'"initiator":"http://127\.0\.0\.1[^\n]*?"url":"\w+://([^/:"]+)')


class Browser:
    """One page, in a browser that keeps its files in a folder."""

    def __init__(self, url: str, folder: Path) -> None:
        self._folder = folder
        commands, self._commands = os.pipe()
        self._answers, answers = os.pipe()
        shell = f'exec "$@" 3<&{commands} 4>&{answers}'  # the descriptors that Chromium reads and writes
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "bash", str(CHROMIUM), *_FLAGS],
            cwd=folder,
            pass_fds=(commands, answers),
            stderr=subprocess.DEVNULL,
        )
        os.close(commands)
        os.close(answers)
        self._number = 0  # of the last command
        self._read = b""
        self._session: dict[str, str] = {}
        target = self._ask("Target.createTarget", url=url)["targetId"]
        self._session = {"sessionId": self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait(DEADLINE_S)
        os.close(self._commands)
        os.close(self._answers)

    def photograph(self) -> Path:
        """Make a picture of the page as it is now; returns the file."""
        picture = self._folder / "page.png"
        picture.write_bytes(base64.b64decode(self._ask("Page.captureScreenshot")["data"]))
        return picture

    def end(self) -> set[str]:
        """End the browser; returns the hosts that its page asked for something."""
        self._session = {}
        self._ask("Browser.close")
        self._process.wait(DEADLINE_S)
        return set(_HOSTS.findall((self._folder / "net.json").read_text(encoding="utf-8")))

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the DevTools protocol; returns its result."""
        self._number += 1
        command = {"id": self._number, "method": method, "params": parameters} | self._session
        os.write(self._commands, json.dumps(command).encode() + b"\0")
        while True:
            while b"\0" not in self._read:
                part = os.read(self._answers, 2**16)
                assert part, f"Chromium ended, code {self._process.poll()}"
                self._read += part
            raw, _, self._read = self._read.partition(b"\0")
            if (answer := json.loads(raw)).get("id") == self._number:
                return answer["result"]
