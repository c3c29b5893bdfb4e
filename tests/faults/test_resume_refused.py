"""What cannot be resumed is bad input in one line, and stays as it was; what can is watched like any run."""

import json
import os
import socket
from pathlib import Path

import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.resume import back
from meanflock.groundstation.results.run_folder import CHECKPOINT, RunFolder
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from tests.faults.conftest import scenario
from tests.faults.dying import LATER, dead, flight, resumed, steady

SPRING = Path(__file__).parents[2] / "examples" / "spring.py"


def refuses(folder: Path, *parts: str) -> None:
    with pytest.raises(BadInput) as caught:
        back(folder)
    assert len(str(caught.value).splitlines()) == 1
    for part in parts:
        assert part in str(caught.value)


def test_what_cannot_be_resumed_is_bad_input_in_one_line_and_nothing_is_touched(tmp_path: Path) -> None:
    flown = scenario(LATER)
    refuses(tmp_path / "nowhere", "no run")
    flight(tmp_path / "whole", flown)
    refuses(tmp_path / "whole" / "run", "finished", "meanflock run")
    folder = dead(tmp_path / "dead", flown, 150)
    kept = (folder / CHECKPOINT).read_bytes()
    (folder / CHECKPOINT).unlink()
    refuses(folder, CHECKPOINT, "hundred ticks")
    for damage in (kept[:-10], b"", b"\xc1" * 100, kept[: len(kept) // 2] + b"\0" + kept[len(kept) // 2 :]):
        (folder / CHECKPOINT).write_bytes(damage)
        refuses(folder, "resumed")
    (folder / CHECKPOINT).write_bytes(kept)
    spool = folder / ".telemetry"
    rows = spool.read_bytes()
    os.truncate(spool, 9000)
    refuses(folder, "missing")
    spool.write_bytes(rows)
    other = (folder / "scenario.toml").read_text()
    (folder / "scenario.toml").write_text(other.replace("seed = 3", "seed = 4"))
    assert main(["resume", str(folder), "--in-process", "--no-record", "--quiet"]) == 2
    (folder / "scenario.toml").write_text(other)
    assert resumed(folder)["ticks"] == 350


@pytest.mark.parametrize("more", [(), ("--in-process",)])
def test_a_run_whose_plugin_was_changed_since_is_refused_with_the_copy_that_flew(
    more: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(SPRING.read_text(encoding="utf-8"), encoding="utf-8")
    plugins.load_file(mine)
    folder = dead(tmp_path / "runs", scenario(LATER, method="spring"), 150)
    mine.write_text(SPRING.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    line = ["resume", str(folder), "--no-record", "--quiet", *more]
    assert main([*line, "--plugin", str(mine)]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    copy = str(folder / "plugins" / "mine.py")
    assert f"controller 'spring' of {plugins.fingerprint(Path(copy).read_bytes())}; here it is of " in said
    assert said.endswith(f"read the copy of what flew and name that: meanflock resume {folder} --plugin {copy}")


def test_a_run_that_is_still_being_written_is_not_resumed(tmp_path: Path) -> None:
    flown = scenario(LATER)
    folder = RunFolder(tmp_path, "run", flown)
    engine = Engine(flown, "run", sinks=[folder])
    for tick in engine.fly():
        if tick == 150:
            break
    before = (tmp_path / "run" / ".telemetry").stat().st_size
    assert main(["resume", str(tmp_path / "run"), "--in-process", "--no-record", "--quiet"]) == 2
    assert (tmp_path / "run" / ".telemetry").stat().st_size == before
    with folder:
        pass


def test_a_resumed_run_can_be_watched_and_logged_like_any_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = scenario(LATER)
    expected = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 150)
    capsys.readouterr()
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    got = resumed(folder, "--metrics", "0", "--log-format", "json")
    said = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert {(line["run"], line["node"]) for line in said} == {("run", "in-process")}
    assert sum(line["message"].startswith("metrics at http://127.0.0.1:") for line in said) == 1
    assert steady(got) == steady(expected)


def test_a_watch_that_cannot_be_kept_is_bad_input_and_the_run_can_still_be_resumed(tmp_path: Path) -> None:
    folder = dead(tmp_path, scenario(LATER), 150)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = str(server.getsockname()[1])
        for flags in (("--metrics", taken), ("--metrics", "everywhere"), ("--log-format", "xml")):
            assert main(["resume", str(folder), "--in-process", "--quiet", *flags]) == 2
            assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert resumed(folder)["ticks"] == 350
