"""Run folders from elsewhere, with odd records, pipes and devices in them: a marked row, and no hang or traceback."""

import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import meanflock as mf
from meanflock.cli.command import main
from meanflock.results.event_log import EventLog
from meanflock.results.quantities import SUMMARY
from meanflock.results.summary_file import Summary, read_summary
from meanflock.studies import job_file
from meanflock.studies.store import Store
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, BadInput
from tests.groundstation.conftest import QUICK

DEEP = 1100


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    for seed in ("1", "2"):
        assert main([*QUICK, "--seed", seed, "--out", str(folder)]) == EXIT_DONE
    return folder


@pytest.fixture
def bad(flown: Path, run: Any, tmp_path: Path) -> Path:
    """The run that a test spoils, beside a good one, in the folder `runs`."""
    shutil.copytree(flown, tmp_path / "runs")
    (folder,) = Path("runs").glob("*-s2")
    return folder


def summary(**fields: Any) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / "summary.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | fields))

    return spoil


def written(name: str, content: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(content) and None


def added(line: str) -> Callable[[Path], None]:
    """A line at the start of the scenario."""

    def spoil(folder: Path) -> None:
        path = folder / "scenario.toml"
        path.write_text(f"{line}\n{path.read_text()}")

    return spoil


def pipe(name: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        os.mkfifo(folder / name)

    return spoil


def endless(name: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to("/dev/zero")

    return spoil


def sparse(name: str) -> Callable[[Path], None]:
    return lambda folder: os.truncate(folder / name, 2**40)


RECORDS = {
    "a table for a number": (summary(arrived={"x": 1}), "Expected `int | float | null`, got `object` - at `$.arrived`"),
    "a number that is none": (summary(phi_A=math.nan), "not JSON"),
    "an endless number": (written("summary.json", b'{"schema": 1, "rounds": 1e999}'), "of range"),
    "a number of 400 digits": (summary(collisions=10**400), "at `$.collisions`"),
    "a number for a table": (summary(payload_bits=3), "Expected `object`, got `int` - at `$.payload_bits`"),
    "a text for a table": (summary(radio="none"), "at `$.radio`"),
    "a list for a name": (summary(method=[["mfg"]]), "at `$.method"),
    "nothing": (written("summary.json", b"null"), "Expected `object`, got `null`"),
    "no JSON": (written("summary.json", b"{"), "not JSON"),
    "not UTF-8": (written("summary.json", b'{"schema": "\xff"}'), "not JSON"),
    "lists in lists": (
        written("summary.json", b'{"schema": 1, "a":' + DEEP * b"[" + DEEP * b"]" + b"}"),
        "summary.json",
    ),
    "a date": (added("note = 1979-05-27"), "not the scenario of a run"),
    "a scenario with nan": (added("note = nan"), "not the scenario of a run"),
    "a text for a number": (added('dt = "0.1"'), "scenario.toml"),
    "no UAVs": (written("scenario.toml", b"uavs = 0"), "Expected `int` >= 1"),
    "tables in tables": (added(f"a{DEEP * '.a'} = 1"), "scenario.toml"),
    "a pipe for a summary": (pipe("summary.json"), "summary.json: not a regular file"),
    "a pipe for a scenario": (pipe("scenario.toml"), "scenario.toml: not a regular file"),
    "a device for a summary": (endless("summary.json"), "summary.json: not a regular file"),
    "a device for a scenario": (endless("scenario.toml"), "scenario.toml: not a regular file"),
    "a summary of a terabyte": (sparse("summary.json"), "summary.json: larger than"),
    "a scenario of a terabyte": (sparse("scenario.toml"), "scenario.toml: larger than"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_an_odd_record_is_one_marked_row_and_a_line_where_it_is_asked_for(run, bad: Path, tmp_path, name: str) -> None:
    spoil, says = RECORDS[name]
    spoil(bad)
    code, out, err = run("list", "--json")
    assert (code, err) == (EXIT_DONE, "")
    strict = msgspec.json.decode(out)  # NaN is no JSON
    assert sorted((each["status"], says in str(each["fault"])) for each in strict) == [
        ("damaged", True),
        ("finished", False),
    ]
    for line in (("list",), ("list", "--html", "page.html")):
        code, out, err = run(*line)
        assert (code, err) == (EXIT_DONE, "")
    assert (tmp_path / "page.html").read_text().count("<article") == 2
    for line in (("show", bad), ("show", bad, "--json"), ("diff", bad, bad)):
        code, out, err = run(*map(str, line))
        assert (code, out, err.count("\n"), says in err) == (EXIT_BAD_INPUT, "", 1, True)


LINES = {
    "cut off": b'{"tick": 3, "kind": "coll',
    "not UTF-8": b"\xff\x00\xfe\n",
    "no object": b"null\n",
    "a list": b"[1, 2]\n",
    "lists in lists": 10 * DEEP * b"[" + b"\n",
    "an endless number": b'{"tick": 1e999, "kind": "collision", "text": "", "uavs": [0]}\n',
    "a megabyte": b'{"tick": 1, "kind": "failed", "text": "' + b"x" * 10**6 + b'", "uavs": []}\n',
}


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("has_summary", [True, False])
def test_events_that_end_in_an_odd_line_are_read_or_refused(run, undrawn, bad: Path, name: str, has_summary) -> None:
    with (bad / "events.jsonl").open("ab") as events:
        events.write(LINES[name])
    if not has_summary:
        (bad / "summary.json").unlink()
    code, out, _ = run("show", str(bad))
    assert (code, "interrupted" in out, "did not finish" in " ".join(out.split())) == (
        EXIT_DONE,
        has_summary,
        not has_summary,
    )
    for line in (("list",), ("plot", str(bad), "--out", "plots"), ("show", str(bad), "--rounds")):
        assert run(*line)[0] == EXIT_DONE
    if has_summary and name not in ("an endless number", "a megabyte"):
        with pytest.raises(BadInput, match=r"events\.jsonl: damaged"):
            mf.open(bad).events  # noqa: B018


def test_a_number_that_is_unknown_is_shown_as_such(run, bad: Path) -> None:
    fields = json.loads((bad / "summary.json").read_text())
    numbers = [key for key, value in fields.items() if isinstance(value, int | float) and key != "schema"]
    summary(**dict.fromkeys(numbers), radio=dict.fromkeys(fields["radio"], None) | {"traffic": {}})(bad)
    for line in (("show", bad), ("list",), ("list", "--html", "p.html"), ("show", bad, "--json"), ("diff", bad, bad)):
        assert run(*map(str, line))[0] == EXIT_DONE


def test_the_type_of_a_summary_has_the_fields_of_the_registry_and_reads_what_a_flight_writes(flown: Path) -> None:
    assert set(Summary.__struct_fields__) == {field.key.partition(".")[0] for field in SUMMARY}
    for folder in flown.iterdir():
        assert read_summary(folder / "summary.json") == json.loads((folder / "summary.json").read_text())


OTHERS = ("events.jsonl", "timeseries.parquet", "checkpoint.msgpack", ".telemetry", "recording.rrd")
COMMANDS = (
    ("list",),
    ("list", "--html", "page.html"),
    ("show", "RUN"),
    ("plot", "RUN", "--csv", "rows.csv"),
    ("export", "RUN", "--mcap", "out.mcap"),
    ("view", "RUN", "--web"),
    ("resume", "RUN", "--in-process", "--quiet", "--no-record"),
)


@pytest.mark.parametrize("spoil", [pipe, endless])
@pytest.mark.parametrize("name", OTHERS)
def test_no_command_waits_for_a_pipe_or_reads_a_device_without_end(run, bad: Path, spoil, name: str) -> None:
    spoil(name)(bad)
    if name in ("events.jsonl", "checkpoint.msgpack", ".telemetry"):
        (bad / "summary.json").unlink()
    for command in COMMANDS:
        if name == "timeseries.parquet" or command[0] not in ("plot", "export"):
            code, _, err = run(*(str(bad) if word == "RUN" else word for word in command))
            assert code in (EXIT_DONE, EXIT_RUN_FAILED, EXIT_BAD_INPUT)
            assert "Traceback" not in err
            if command[0] in ("view", "resume"):
                assert (code, err.count("\n")) != (EXIT_DONE, 1)


def test_events_are_written_to_no_file_outside_the_folder(bad: Path, tmp_path: Path) -> None:
    (precious := tmp_path / "precious").write_text("much")
    (bad / "events.jsonl").unlink()
    (bad / "events.jsonl").symlink_to(precious)
    with pytest.raises(OSError, match="symbolic links"):
        EventLog(bad / "events.jsonl", dt=0.1)
    assert precious.read_text() == "much"


def odd(column: str, value: Any) -> Callable[[pa.Table], pa.Table]:
    return lambda rows: rows.set_column(rows.schema.get_field_index(column), column, value(rows))


SERIES = {
    "no positions": lambda rows: rows.select(["tick", "status"]),
    "numbers for lists": odd("x_m", lambda rows: rows["phi_A"]),
    "lists of other numbers": odd("status", lambda rows: rows["x_m"]),
    "a UAV too few": odd("y_m", lambda rows: pa.array([[0.0] * (3 - (tick == 5)) for tick in range(len(rows))])),
    "no entries": odd("y_m", lambda rows: pa.array([None] * len(rows), rows["y_m"].type)),
    "positions that are none": odd("y_m", lambda rows: pa.array([[math.nan] * 3] * len(rows))),
}


@pytest.mark.parametrize("name", SERIES)
def test_an_odd_time_series_has_no_picture_and_is_named(run, bad: Path, tmp_path: Path, name: str) -> None:
    path = bad / "timeseries.parquet"
    pq.write_table(SERIES[name](pq.read_table(path)), path)
    assert run("list", "--html", "page.html")[0] == EXIT_DONE
    assert (tmp_path / "page.html").read_text().count("no picture") == 1
    if name != "positions that are none":
        code, _, err = run("plot", str(bad), "--csv", "rows.csv")
        assert (code, err.count("\n"), "damaged" in err) == (EXIT_BAD_INPUT, 1, True)


def test_a_job_that_is_a_pipe_or_unpacks_without_end_is_flown_again(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(job_file, "LOG_BYTES", 1000)
    jobs = Store(tmp_path).data / "jobs"
    os.mkfifo(jobs / "pipe.job")
    run = job_file.StoredRun("key", {"text": 10_000 * "a"})
    (jobs / "bomb.job").write_bytes(job_file.encode([run]))
    assert Store(tmp_path).finished() == {}
    assert list(jobs.iterdir()) == []
