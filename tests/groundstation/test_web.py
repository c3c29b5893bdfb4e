"""The page of `--web`: a browser shows the recording, finished or live, and connects to no other host."""

import http.client
import json
import re
import shutil
import signal
import subprocess
import urllib.parse
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from meanflock.groundstation import doctor
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.recording.replay import verify
from meanflock.groundstation.recording.web import WebPage
from meanflock.swarm import logs
from meanflock.swarm.errors import EXIT_DONE
from meanflock.swarm.scenario import Scenario
from tests.commands import COMMAND, ended
from tests.groundstation.recordings import flight, record
from tests.polling import DEADLINE_S, until

CANVAS, GOAL = (16, 19, 26), (0x35, 0xD6, 0xA0)  # colours of the map's background and of the goal's ring on it
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
OWN = {  # hosts that Chromium asks by itself, whatever page it shows
    *("accounts.google.com", "clients2.google.com", "update.googleapis.com", "start.duckduckgo.com"),
    *("content-autofill.googleapis.com", "optimizationguide-pa.googleapis.com"),
}
FLAGS = (
    *("--headless", "--no-sandbox", "--incognito", "--no-first-run", "--disable-dev-shm-usage"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=640,480"),
    *("--virtual-time-budget=20000", "--proxy-server=http://127.0.0.1:9"),  # no proxy: nothing leaves this machine
    *("--user-data-dir=profile", "--screenshot=page.png", "--log-net-log=net.json"),
)


def answer(url: str, host: str = "127.0.0.1") -> http.client.HTTPResponse:
    """The answer to a GET request, redirections not followed."""
    asked = urllib.parse.urlsplit(url)
    connection = http.client.HTTPConnection(asked.netloc, timeout=DEADLINE_S)
    connection.request("GET", f"{asked.path}?{asked.query}" if asked.query else asked.path, headers={"Host": host})
    return connection.getresponse()


def shown_at(page: str) -> str:
    """Where the page at that URL takes its recording from."""
    parameters = urllib.parse.urlsplit(answer(page, urllib.parse.urlsplit(page).netloc).headers["Location"]).query
    return urllib.parse.parse_qs(parameters)["url"][0]


@pytest.mark.processes
@pytest.mark.xdist_group("browser")
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")
def test_a_browser_shows_the_recording_and_asks_nobody_else(tmp_path: Path) -> None:
    recorder = Recorder(Scenario(uavs=4), "test", tmp_path / "recording.rrd", serve=("127.0.0.1", 0))
    asked: set[str] = set()

    def shows_a_map() -> bool:
        """Whether a fair part of the page is the map's canvas, with the goal on it."""
        ended(CHROMIUM, *FLAGS, page.url, cwd=tmp_path)
        asked.update(re.findall(r'"url":"\w+://([^/:"]+)', (tmp_path / "net.json").read_text(encoding="utf-8")))
        seen = np.round(imread(tmp_path / "page.png")[..., :3] * 255)
        return bool(np.mean((seen == CANVAS).all(axis=-1)) > 0.05 and (seen == GOAL).all(axis=-1).sum() > 5)

    with WebPage() as page, recorder:
        for block in flight(uavs=4, ticks=200):
            recorder.write(block)
        recorder.flush()
        page.recording = recorder.live_url
        until(shows_a_map, "the map in the browser, which comes late")
    assert asked - OWN == {"127.0.0.1"}
    assert verify(tmp_path / "recording.rrd") is None


@pytest.mark.processes
def test_view_serves_the_page_and_the_recording_to_this_machine_until_ctrl_c(tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    record(path, flight(ticks=60))
    serving = subprocess.Popen([*COMMAND, "view", path, "--web"], stdout=subprocess.PIPE, text=True)
    try:
        page = serving.stdout.readline().strip()
        assert urllib.parse.urlsplit(page).hostname == "127.0.0.1"
        assert answer(shown_at(page)).read() == path.read_bytes()
        assert b"Rerun" in answer(f"{page}?url={shown_at(page)}").read()
        for foreign in ("rerun.io", "127.0.0.1.example.org", ""):
            assert answer(shown_at(page), foreign).status == http.HTTPStatus.FORBIDDEN
        assert answer(f"{page}scenario.toml").status == http.HTTPStatus.NOT_FOUND
    finally:
        serving.send_signal(signal.SIGINT)
        serving.wait(DEADLINE_S)
    assert serving.returncode == EXIT_DONE
    with pytest.raises(ConnectionRefusedError):
        answer(page)


def test_a_flight_is_shown_live_and_afterwards_its_recording(run, monkeypatch: pytest.MonkeyPatch) -> None:
    sources: list[str] = []  # of what each address that is told shows at that moment

    def tell(text: str, *_: int) -> None:
        sources.extend(map(shown_at, re.findall(r"http://\S+", text)))

    monkeypatch.setattr(logs, "show", tell)
    monkeypatch.setattr(doctor, "VIEWER_PORT", 0)
    monkeypatch.setattr(WebPage, "attend", lambda page: None)
    code, out, _ = run("run", "--in-process", "--view", "--web", "--uavs", "2", "--duration", "2", "--json")
    assert (code, json.loads(out)["uavs"]) == (EXIT_DONE, 2)
    live, recorded = map(urllib.parse.urlsplit, sources)
    assert (live.scheme, live.hostname) == ("rerun+http", "127.0.0.1")
    assert (recorded.scheme, recorded.path) == ("http", "/recording.rrd")
