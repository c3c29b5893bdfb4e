"""The table of golden flights: what each flies, and the trajectory and the bill it must have.

`python -m tests.golden.flights` writes the table anew; do that only when a flight changes on purpose, and say why.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import tests.one_kernel  # noqa: F401  # isort: skip
import numpy as np

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.scenario import Scenario

TABLE = Path(__file__).with_name("flights.json")
VOLATILE = {"wall_time_s", "real_time_factor", "mode", "backend", "run_id", "wire_bytes", "dropped_messages"}


class Golden(NamedTuple):
    """A row of the table."""

    name: str
    mission: str | None
    settings: list[str]
    sha256: str
    payload_bits: dict[str, int]

    @property
    def scenario(self) -> Scenario:
        return scenarios.load(self.mission and Path(self.mission), self.settings)

    def fly(self, **options: Any) -> dict[str, Any]:
        return Engine(self.scenario, "golden", **options).complete()

    def check(self, summary: dict[str, Any]) -> None:
        """Compares a flight with the row."""
        assert summary["payload_bits"] == self.payload_bits
        assert summary["trajectory_sha256"] == self.sha256


def read() -> tuple[str, list[Golden]]:
    """The kind of machine that flew the table, and its rows."""
    table = json.loads(TABLE.read_text())
    return table["machine"], [Golden(**row) for row in table["flights"]]


def machine() -> str:
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
    for row in read()[1]:
        summary = row.fly()
        rows.append(row._replace(sha256=summary["trajectory_sha256"], payload_bits=summary["payload_bits"]))
    lines = ",\n".join(json.dumps(row._asdict()) for row in rows)
    TABLE.write_text(f'{{"machine": "{machine()}", "flights": [\n{lines}\n]}}\n')


if __name__ == "__main__":
    write()
