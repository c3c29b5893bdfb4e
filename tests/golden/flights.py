"""The table of golden flights: what each flies, and the trajectory and the bill it must have.

`python -m tests.golden.flights` flies all rows on this processor and adds what they are. Where a row has changed on
this processor, what it was on others goes; do that only when a flight changes on purpose, and say why.
"""

import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import tests.one_kernel  # noqa: F401  # isort: skip
import numpy as np

from meanflock.launch.engine import Engine
from meanflock.results.quantities import VARYING
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.scenario import Scenario

TABLE = Path(__file__).with_name("flights.json")
VOLATILE = VARYING | {"wire_bytes", "dropped_messages"}


class Golden(NamedTuple):
    """A row of the table. `sha256`: by the kind of processor that flew it, see `processor`."""

    name: str
    mission: str | None
    settings: list[str]
    sha256: dict[str, str]
    payload_bits: dict[str, int]

    @property
    def scenario(self) -> Scenario:
        return scenarios.load(self.mission and Path(self.mission), self.settings)

    def fly(self, **options: Any) -> dict[str, Any]:
        return Engine(self.scenario, "golden", **options).complete()

    def check(self, summary: dict[str, Any]) -> None:
        """Compares a flight with the row."""
        assert summary["payload_bits"] == self.payload_bits
        assert summary["trajectory_sha256"] == self.sha256[processor()]


def read() -> list[Golden]:
    """The rows of the table."""
    return [Golden(**row) for row in json.loads(TABLE.read_text())]


@cache
def processor() -> str:
    """Hash of NumPy's functions and products on this processor; where it differs, so may the last bits of a flight."""
    x = np.linspace(0.01, 7.0, 4097)
    parts = [np.exp(x), np.log(x), np.sin(x), np.cos(x), np.tanh(x), np.arctan2(x, 2.0), np.hypot(x, 3.0), x**2.5]
    parts.append(np.sin(np.outer(x[:64], x[:64])) @ np.cos(np.outer(x[:64], x[:25])))
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:16]


def steady(summary: dict[str, Any]) -> dict[str, Any]:
    """The part of a summary that depends on the scenario alone: not on clocks, processes or the bytes between them."""
    fields = {name: value for name, value in summary.items() if name not in VOLATILE | {"radio"}}
    radio = {name: value for name, value in summary["radio"].items() if name != "traffic"}
    bills = {
        kind: {name: value for name, value in bill.items() if name != "wire_bytes"}
        for kind, bill in summary["radio"]["traffic"].items()
    }
    return {**fields, "radio": radio, "bills": bills}


def write() -> None:
    """Flies all rows and writes what they are now."""
    rows = []
    for row in read():
        summary = row.fly()
        now = {processor(): summary["trajectory_sha256"]}
        sha256 = row.sha256 | now if row.sha256.get(processor()) in (None, *now.values()) else now
        rows.append(row._replace(sha256=sha256, payload_bits=summary["payload_bits"]))
    lines = ",\n".join(json.dumps(row._asdict()) for row in rows)
    TABLE.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    write()
