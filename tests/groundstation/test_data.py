"""The data dictionary: page, metadata and files of runs agree."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.launch.options import Options
from meanflock.groundstation.launch.run import fly
from meanflock.groundstation.results import event_log, inbound, quantities
from meanflock.groundstation.results.run_folder import EVENTS, SUMMARY
from meanflock.groundstation.results.series import diagnostics_in
from meanflock.groundstation.results.series import schema as schema_of
from meanflock.groundstation.results.timeseries_file import TIMESERIES
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Status
from tests.groundstation.recordings import flight
from tests.pages import script_of

FAULTS = [{"kind": "kill", "tick": 20, "uavs": [1]}, {"kind": "leader-loss", "tick": 250}]


@pytest.fixture(scope="module", params=["offline", "mfgfl-hf"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short flight with faults, in real time where it learns most."""
    flown = load(None, method=request.param, uavs=4, duration=30.0, faults=FAULTS)
    realtime = 200.0 if request.param == "mfgfl-hf" else None
    out = tmp_path_factory.mktemp("runs")
    return fly(flown, Options(out=out, in_process=True, record=False, quiet=True, realtime=realtime)).folder


def test_the_page_is_that_of_the_code() -> None:
    script = script_of("data")
    assert script.PAGE.read_text(encoding="utf-8") == script.page(), "run `python docs/data.py`"


def test_every_column_says_what_it_is_in_the_file_itself(run: Path) -> None:
    schema = pq.read_schema(run / TIMESERIES)
    described = quantities.columns(diagnostics_in(schema))
    assert schema.names == [column.key for column in described]
    for column in described:
        told = {key.decode(): value.decode() for key, value in schema.field(column.key).metadata.items()}
        assert told["description"] == column.about
        assert told["unit"] == column.unit
        assert told["cumulative"] == ("true" if column.cumulative else "false")
    assert schema.types == schema_of(diagnostics_in(schema)).types
    assert [str(schema.field(name).type) for name in ("tick", "x_m", "energy_J", "status", "phi_A")] == [
        "int32", "list<element: double>", "list<element: float>", "list<element: uint8>", "double",
    ]  # fmt: skip
    values = schema.field("status").metadata[b"values"].decode()
    assert values == ", ".join(f"{status.value} {status.name.lower()}" for status in Status)
    rows = pq.read_table(run / TIMESERIES)
    for column in described:  # a count that is cumulative never falls; means may
        if column.cumulative and not column.key.startswith("phi_"):
            assert (np.diff(np.array(rows[column.key].to_pylist()), axis=0) >= 0).all(), column.key


def flat(record: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in record.items():
        if isinstance(value, dict) and (
            value or prefix + key in ("diagnostics", "diagnostics_max", "dropped_messages")
        ):
            yield from flat(value, f"{prefix}{key}.") if value else [f"{prefix}{key}.*"]
        else:
            yield prefix + key


def described(key: str, known: set[str]) -> str | None:
    """The entry of the table for a field."""
    parts = key.split(".")
    wild = [
        ".".join("*" if place == hidden else part for place, part in enumerate(parts)) for hidden in range(len(parts))
    ]
    return next((name for name in (key, *wild) if name in known), None)


def test_every_field_of_the_summary_is_described_and_every_described_field_is_there(run: Path) -> None:
    summary = json.loads((run / SUMMARY).read_text())
    known = {field.key for field in quantities.SUMMARY}
    assert len(known) == len(quantities.SUMMARY)
    found = {key: described(key, known) for key in flat(summary)}
    assert not [key for key, entry in found.items() if entry is None]
    absent = set()
    for table in ("realtime", "steered"):
        absent |= {key for key in known if key.startswith(f"{table}.")} if summary[table] is None else {table}
    assert known - set(found.values()) == absent


def test_every_kind_of_event_is_described(run: Path) -> None:
    told = [json.loads(line) for line in (run / EVENTS).read_text().splitlines()]
    assert {"joined", "fault", "lost", "finished"} <= {event["kind"] for event in told} <= set(event_log.KINDS)
    assert all(set(event) == set(event_log.FIELDS) for event in told)
    assert set(event_log.LEVELS) <= set(event_log.KINDS)


def test_a_block_with_a_diagnostic_called_as_a_column_is_rejected() -> None:
    (block,) = flight(uavs=2, ticks=20)
    inbound.check(block, 2)
    for names in (("status", "b", "c"), ("b", "b", "c"), ("not a name", "b", "c")):
        with pytest.raises(MessageRejected, match="diagnostics"):
            inbound.check(msgspec.structs.replace(block, diagnostic_names=names), 2)
