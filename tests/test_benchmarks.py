"""The benchmark command works and says what it promises; what it measures is nobody's test."""

import json
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from benchmarks import page, peers, profile, scaling, store
from benchmarks.__main__ import PAGE
from benchmarks.peer import environment
from benchmarks.processes import BenchmarkFailed
from tests.polling import DEADLINE_S

ROOT = Path(__file__).parents[1]
FIGURE = {
    "name", "unit", "better", "median", "min", "max", "samples", "floor", "ratio", "ratio_min", "ratio_max",
    "target", "stretch", "ratio_target", "ratio_stretch", "note",
}  # fmt: skip


def benchmarks(*flags: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "benchmarks", *flags]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=DEADLINE_S)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    """The record and the page of the fastest race with the smallest counts."""
    folder = tmp_path_factory.mktemp("benchmarks")
    record, page = folder / "latest.json", folder / "performance.md"
    done = benchmarks("--quick", "--only", "wire", "--json", str(record), "--page", str(page))
    assert done.returncode == 0, done.stderr
    assert not done.stdout
    return json.loads(record.read_text(encoding="utf-8")), page.read_text(encoding="utf-8")


def test_the_record_says_what_was_measured_on_what(written: tuple[dict[str, Any], str]) -> None:
    record, _ = written
    assert set(record) == {"schema", "date", "seconds", "machine", "versions", "races"}
    assert record["machine"]["cores"] >= 1
    assert record["versions"]["numpy"] != "absent"
    assert set(record["races"]) == {"wire"}


def test_every_figure_is_whole_and_names_a_floor_that_is_there(written: tuple[dict[str, Any], str]) -> None:
    race = written[0]["races"]["wire"]
    assert race["error"] is None
    assert race["effort"] == "quick"
    names = {figure["name"] for figure in race["figures"]}
    for figure in race["figures"]:
        assert set(figure) == FIGURE
        assert figure["min"] <= figure["median"] <= figure["max"]
        assert figure["floor"] is None or figure["floor"] in names
        assert (figure["ratio"] is None) == (figure["floor"] is None)


def test_an_upload_costs_little_more_than_its_payload(written: tuple[dict[str, Any], str]) -> None:
    uploads = [figure for figure in written[0]["races"]["wire"]["figures"] if figure["ratio_target"]]
    assert len(uploads) == 3
    assert all(figure["ratio"] <= figure["ratio_target"] for figure in uploads)


def test_the_page_has_a_row_for_every_figure(written: tuple[dict[str, Any], str]) -> None:
    record, page = written
    assert page.startswith("# Performance\n")
    assert all(f"| {figure['name']} |" in page for figure in record["races"]["wire"]["figures"])


def test_an_unknown_race_is_refused() -> None:
    done = benchmarks("--only", "nonsense")
    assert done.returncode == 2
    assert "nonsense" in done.stderr


# -- what got worse -----------------------------------------------------------------------------------------------


def found(*ratios: tuple[str, float, str], effort: str = "full", error: str | None = None) -> dict[str, Any]:
    """A record of one race."""
    figures = [{"name": name, "ratio": ratio, "better": better} for name, ratio, better in ratios]
    return {"races": {"race": {"effort": effort, "error": error, "figures": figures}}}


def test_a_ratio_that_grew_by_more_than_noise_is_named_and_one_that_fell_is_not() -> None:
    before = found(("tick", 2.0, "lower"), ("speed", 2.0, "higher"), ("size", 2.0, "neither"))
    assert store.worse(found(("tick", 2.2, "lower"), ("speed", 1.8, "higher"), ("size", 9.0, "neither")), before) == []
    worse = store.worse(found(("tick", 3.0, "lower"), ("speed", 1.0, "higher"), ("size", 2.0, "neither")), before)
    assert [sentence.split(" (")[-1] for sentence in worse] == ["50 % worse)", "100 % worse)"]
    assert "3.00 times its floor, was 2.00" in worse[0]


def test_what_cannot_be_measured_any_more_is_named() -> None:
    before = found(("tick", 2.0, "lower"), ("size", 1.0, "neither"))
    assert store.worse(found(error="it fell over"), before) == ["race: cannot be measured any more: it fell over"]
    assert store.worse(found(("tick", 2.0, "lower")), before) == ["race: size: not measured any more"]
    assert store.worse(found(("tick", 2.0, "lower"), effort="quick"), before) == []
    assert store.worse(found(error="it never ran"), {"races": {}}) == []


# -- peers --------------------------------------------------------------------------------------------------------


def test_every_peer_has_pins_and_a_script() -> None:
    for race in peers.RACES:
        assert all("==" in pin for pin in environment.pins(race.peer))
        assert any(pin.startswith(f"{race.peer}==") for pin in environment.pins(race.peer))
        assert (environment.SCRIPTS / f"{race.script}.py").is_file()


def test_no_two_figures_of_the_races_share_a_name() -> None:
    names = [f"{race.peer}: {race.theirs}" for race in peers.RACES] + [race.ours for race in peers.RACES]
    assert len(names) == len(set(names)), "the regression check tells figures apart by their names"


def test_a_peer_that_is_not_set_up_says_how_to(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkFailed, match="--setup pyrvo"):
        environment.Environment("pyrvo", tmp_path).start("pyrvo_orca", 5)


@pytest.mark.parametrize(
    ("code", "seconds", "why"),
    [
        ("print('ERROR: no wheel'); print('a hint'); raise SystemExit(1)", 60.0, "ERROR: no wheel"),
        ("raise SystemExit(1)", 60.0, "it said nothing"),
        ("input(); import time; time.sleep(60)", 0.0, "not installed in time"),
    ],
)
def test_a_peer_that_cannot_be_installed_says_why(tmp_path: Path, code: str, seconds: float, why: str) -> None:
    with pytest.raises(BenchmarkFailed, match=why):
        environment.install([sys.executable, "-c", code], tmp_path / "log", time.monotonic() + seconds)


PEER = """
import sys
sys.path.insert(0, {scripts!r})
from serve import serve
serve(lambda: sum(range(1000)))
"""


def test_a_peer_is_timed_in_its_own_process_and_ends_with_it() -> None:
    with environment.Peer([sys.executable, "-c", PEER.format(scripts=str(environment.SCRIPTS))], "peer 1") as peer:
        assert 0.0 < peer.measure(10) < 1000.0
        assert 0.0 < peer.measure(1) < 1000.0
        process = peer._process
        assert process.poll() is None
    assert process.poll() is not None


LEAVES_BEHIND = """
import subprocess, sys, tempfile
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
tempfile.mkstemp()
print("ready", flush=True)
input()
print(child.pid, flush=True)
input()
"""


def gone(process: psutil.Process) -> bool:
    try:
        return bool(process.status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


def test_what_a_peer_started_and_wrote_goes_with_it() -> None:
    with environment.Peer([sys.executable, "-c", LEAVES_BEHIND], "peer 1") as peer:
        child, folder = psutil.Process(int(peer.measure(1))), Path(peer._folder.name)
        assert not gone(child)
        assert any(folder.iterdir())
    assert gone(child)
    assert not folder.exists()


@pytest.mark.parametrize(
    ("code", "why"), [("raise SystemExit('no wings')", "it ended: no wings"), ("print('hello')", "it did not say")]
)
def test_a_peer_that_does_not_get_ready_says_why(code: str, why: str) -> None:
    with pytest.raises(BenchmarkFailed, match=why):
        environment.Peer([sys.executable, "-c", code], "peer 1")


def test_a_peer_that_is_silent_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "ANSWER_S", 0.2)
    with pytest.raises(BenchmarkFailed, match="no answer"):
        environment.Peer([sys.executable, "-c", "input()"], "peer 1")


# -- scaling ------------------------------------------------------------------------------------------------------


def test_the_fit_recovers_the_costs_a_swarm_was_made_of() -> None:
    costs = np.array([0.5, 4e-3, 2e-6, 1.5e-4, 0.8, 0.3])
    places = [(n, 0, 0) for n in (25, 100, 1000, 4000)] + [(n, 0, n * (n - 1)) for n in (25, 100)]
    places += [(n, n, 0) for n in (25, 50, 200)] + [(1000, 4, 0)]
    samples = [[*place, scaling.Fit(costs, np.empty(0), np.empty(0)).ms(*place)] for place in places]
    fitted = scaling.fit(np.array(samples))
    np.testing.assert_allclose(fitted.coefficients, costs, rtol=1e-6)
    np.testing.assert_allclose(fitted.relative, 0.0, atol=1e-9)
    assert fitted.ms(64, 64) == pytest.approx(0.5 + 64 * 4e-3 + 64**2 * 2e-6 + 0.8 + 64 * 0.3)


def test_the_page_on_scaling_can_be_written_from_the_record_beside_it(tmp_path: Path) -> None:
    page, picture = tmp_path / "scaling.md", tmp_path / "scaling.png"
    page.write_text(scaling.PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    assert scaling.main(["--page", str(page), "--picture", str(picture)]) == 0
    text = page.read_text(encoding="utf-8")
    assert text.split("<!-- fit -->")[0].splitlines()[0] == "# Scaling"
    for name in ("fit", "bytes", "future"):
        assert re.search(rf"<!-- {name} -->\n\|.*?\n<!-- end -->", text, flags=re.DOTALL)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_measurements_on_the_page_are_those_of_the_record() -> None:
    text = PAGE.read_text(encoding="utf-8")
    record = store.read(store.LATEST)
    assert record is not None
    assert page.page(record, text) == text


def test_a_record_without_the_races_is_said(tmp_path: Path, capsys: Any) -> None:
    record = tmp_path / "other.json"
    record.write_text(json.dumps({"schema": store.SCHEMA, "races": {}}))
    assert scaling.main(["--json", str(record)]) == 2
    assert "--only scale scale_processes" in capsys.readouterr().err


def test_what_a_tick_is_taken_apart_into_is_there() -> None:
    with profile.Stopwatch() as watch:
        watch.wrap([*profile.LEARNER, *profile.CODEC, *profile.WORLD, *profile.MEMORY_BUS, *profile.ZENOH_BUS])
        assert watch.absent == []


def test_a_part_is_not_charged_for_what_another_thread_does_meanwhile() -> None:
    began, ended = threading.Event(), threading.Event()

    def waits() -> None:
        began.set()
        ended.wait(DEADLINE_S)

    watch = profile.Stopwatch()
    outer, inner = watch._timed(waits, "waits"), watch._timed(lambda: time.sleep(0.02), "works")
    thread = threading.Thread(target=outer)
    thread.start()
    began.wait(DEADLINE_S)
    inner()
    ended.set()
    thread.join()
    assert watch.ns["works"] >= 0.02e9
    waited = watch.ns["waits, in Zenoh's thread meanwhile"]
    assert waited >= watch.ns["works"]  # all of it, where one stack for both had taken the work off
    rows = {row["part"]: row["us"] for row in watch.parts(1, 1e6)}
    assert rows["everything else"] + rows["works"] == pytest.approx(1e6)  # of the thread whose time it is


def test_a_ratio_below_a_hundredth_is_not_written_as_nothing() -> None:
    figure = {"name": "ours", "note": "", "unit": "ms", "median": 0.2, "min": 0.2, "max": 0.2, "samples": 2}
    bounds = dict.fromkeys(("target", "stretch", "ratio_target", "ratio_stretch"))
    row = page._row(figure | bounds | {"ratio": 0.0023, "ratio_min": 0.002, "ratio_max": 0.104, "better": "lower"})
    assert "| 0.0023 (0.002–0.10) |" in row
