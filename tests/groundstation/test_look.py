"""`view`, `plot` and `picture` of finished and flying runs; displays, repairs, and the page of `--web`."""

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import urllib.parse
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.image import imread

from meanflock.cli import display
from meanflock.launch import doctor
from meanflock.launch.engine import Engine
from meanflock.recording import viewer
from meanflock.recording.recorder import Recorder
from meanflock.recording.replay import recorded, verify
from meanflock.recording.viewer import MISSING_GRAPHICS, screenshot
from meanflock.recording.web import WebPage
from meanflock.results.run_folder import CHECKPOINT, RunFolder
from meanflock.results.series import Reported
from meanflock.swarm import logs, scenario, state
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, BadInput, RunFailed
from meanflock.swarm.scenario import Scenario
from tests.commands import COMMAND, printed
from tests.groundstation.browser import CHROMIUM, Browser
from tests.groundstation.conftest import QUICK
from tests.groundstation.recordings import DIAGNOSTICS, WEIGHTS, flight, record
from tests.polling import DEADLINE_S, until

VERBS = (("view", "--web"), ("plot",), ("picture", "-o", "p.png"), ("resume",), ("export", "--mcap", "r"))
PLOTS = ("paths.png", "paths.svg", "curves.png", "curves.svg")
pytestmark = pytest.mark.usefixtures("strict")

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")


def test_a_run_that_cannot_be_written_is_plotted_elsewhere(run, undrawn) -> None:
    assert run(*QUICK)[0] == EXIT_DONE
    (folder,) = Path("runs").iterdir()
    (folder / "plots").touch()  # so that no folder can be made there, as in a folder that is read-only
    before = {path: path.stat().st_mtime_ns for path in (folder, *folder.iterdir())}
    code, out, _ = run("plot", str(folder), "--out", "drawn")
    assert (code, out.split()) == (EXIT_DONE, [f"drawn/{name}" for name in PLOTS])
    assert {path: path.stat().st_mtime_ns for path in (folder, *folder.iterdir())} == before
    code, _, err = run("plot", str(folder))
    assert (code, "name a folder that can be written: --out DIR" in err) == (EXIT_BAD_INPUT, True)
    code, _, err = run("plot", str(folder), "--out", "drawn", "--csv", "rows.csv")
    assert (code, "leave one out" in err, Path("rows.csv").exists()) == (EXIT_BAD_INPUT, True, False)


def test_a_run_that_still_flies_is_refused_and_not_completed(run, tmp_path) -> None:
    flown = scenario.load(None, ["duration=4", "stop=duration"], uavs=3)
    with (
        RunFolder(tmp_path, "flying", flown) as folder,
        Recorder(flown, "flying", folder.path / "recording.rrd") as recorder,
    ):
        engine = Engine(flown, "flying", sinks=[folder, recorder])
        for tick in engine.fly():
            if tick == 30:
                until((folder.path / CHECKPOINT).exists, "a checkpoint, which is written beside the flight")
            for verb in VERBS if tick == 30 else ():
                code, _, err = run(*verb, str(folder.path))
                assert (code, err.count("\n")) == (EXIT_BAD_INPUT, 1)
                assert "still writes this run" in err
        engine.finish()
    assert verify(folder.path / "recording.rrd") is None
    assert recorded([folder.path / "recording.rrd"]).ticks[-1] == 40
    assert len(pq.read_table(folder.path / "timeseries.parquet")) == 41


def test_pictures_are_drawn_whatever_backend_of_matplotlib_a_notebook_names(run, tmp_path: Path) -> None:
    assert run(*QUICK)[0] == EXIT_DONE
    inline = {**os.environ, "MPLBACKEND": "inline"}  # of a library that is not installed here
    printed(*COMMAND, "list", "--quiet", "--html", "page.html", env=inline, cwd=tmp_path)
    assert "<svg" in (tmp_path / "page.html").read_text()


def test_without_a_display_view_fails_and_names_the_commands_that_work(run, tmp_path, monkeypatch) -> None:
    assert run("run", "--in-process", "--quiet", "--uavs", "2", "--duration", "2")[0] == EXIT_DONE
    (flown,) = (tmp_path / "runs").iterdir()
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    for at in (None, "127.0.0.1:77", ":77", "elsewhere"):
        if at is not None:
            monkeypatch.setenv("DISPLAY", at)
        code, out, err = run("view", str(flown))
        assert (code, out, err.count("\n")) == (EXIT_RUN_FAILED, "", 1)
        for part in ("no display", f"meanflock picture {flown}", f"meanflock view {flown} --web", at or "DISPLAY"):
            assert part in err
    code, _, err = run("run", "--in-process", "--view", "--uavs", "2", "--duration", "2", "--out", "viewed")
    assert (code, "meanflock picture" in err) == (EXIT_RUN_FAILED, True)
    assert not (tmp_path / "viewed").exists()  # nothing was flown


def test_a_display_that_does_not_answer_is_none(tmp_path, monkeypatch) -> None:
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-7")
    with pytest.raises(RunFailed, match="no server answers at WAYLAND_DISPLAY=wayland-7; instead"):
        display.check("instead")
    with socket.socket(socket.AF_UNIX) as compositor:
        compositor.bind(str(tmp_path / "wayland-7"))
        compositor.listen()
        display.check("instead")


def test_a_file_that_is_no_recording_is_refused_and_left_alone(run, tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    for use in (viewer.open_viewer, lambda missing: screenshot(missing, tmp_path / "swarm.png", at_s=0.0)):
        with pytest.raises(BadInput, match="no such recording"):
            use(path)
    record(path, flight(ticks=200))
    for content in (b"not a recording", path.read_bytes()[:-200]):
        path.write_bytes(content)
        assert verify(path) is not None
        code, _, err = run("picture", str(path), "-o", "p.png")
        assert (code, "name the folder of its run, from whose rows it is completed" in err) == (EXIT_BAD_INPUT, True)
        assert ([file.name for file in tmp_path.iterdir()], path.read_bytes()) == ([path.name], content)


NO_GRAPHICS = ("No graphics adapter", "Failed to get render context")  # with and without drivers installed


def drawn(run, recording: str, png: Path, *flags: str) -> np.ndarray:
    """The picture of a recording, 640 × 480; skips the test where no driver can draw it."""
    code, out, err = run("picture", recording, *flags, "-o", str(png), "--size", "640x480")
    if any(reason in err for reason in NO_GRAPHICS) and MISSING_GRAPHICS in err:
        pytest.skip(err)
    assert (code, out) == (EXIT_DONE, f"{png}\n")
    return imread(png)


@pytest.mark.processes
def test_a_picture_shows_the_given_second_or_the_last_without_a_display(run, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    record(tmp_path / "recording.rrd", flight(ticks=200))
    pictures = {}
    for name, flags in {"middle": ("--at", "10"), "last": ("--at", "19.9"), "default": ()}.items():
        pictures[name] = drawn(run, "recording.rrd", tmp_path / "out" / f"{name}.png", *flags)
        assert pictures[name].shape[:2] == (480, 640)
    apart = {name: float(np.abs(pictures[name] - pictures["default"]).mean()) for name in ("last", "middle")}
    assert 10 * apart["last"] < apart["middle"]
    code, _, err = run("picture", "recording.rrd", "--at", "20", "-o", "beyond.png")
    assert code == EXIT_BAD_INPUT
    assert "of 0 to 19.9 s" in err
    assert not (tmp_path / "beyond.png").exists()


@pytest.mark.processes
def test_a_picture_shows_one_view_alone_and_none_in_space_of_a_flight_in_the_plane(run, tmp_path: Path) -> None:
    reported = Reported(DIAGNOSTICS, WEIGHTS)
    record(tmp_path / "space.rrd", flight(ticks=200, axes=state.SPACE), reported)
    record(tmp_path / "plane.rrd", flight(ticks=200))
    canvas = {}
    for name, view in (("space", "all"), ("space", "space"), ("space", "map"), ("plane", "map")):
        picture = drawn(run, f"{name}.rrd", tmp_path / "out" / f"{name}-{view}.png", "--view", view)
        seen = np.round(picture[..., :3] * 255)
        canvas[name, view] = float((seen == CANVAS).all(axis=-1).mean())
    assert canvas["space", "all"] < 0.4
    assert min(share for (_, view), share in canvas.items() if view != "all") > 0.6
    code, _, err = run("picture", "plane.rrd", "--view", "space", "-o", "none.png", "--size", "640x480")
    assert (code, "--view space: the flight is in the plane" in err) == (EXIT_BAD_INPUT, True)
    assert not (tmp_path / "none.png").exists()


CANVAS, GOAL = (16, 19, 26), (0x35, 0xD6, 0xA0)  # colours of the map's background and of the goal's ring on it


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

    def shows_a_map() -> bool:
        """Whether a fair part of the page is the map's canvas, with the goal on it."""
        seen = np.round(imread(browser.photograph())[..., :3] * 255)
        return bool(np.mean((seen == CANVAS).all(axis=-1)) > 0.05 and (seen == GOAL).all(axis=-1).sum() > 5)

    with WebPage() as page, recorder:
        for block in flight(uavs=4, ticks=200):
            recorder.write(block)
        recorder.flush()
        page.recording = recorder.live_url
        with Browser(page.url, tmp_path) as browser:
            until(shows_a_map, "the map in the browser, which comes late", pause_s=0.5)
            assert browser.end() == {"127.0.0.1"}
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
