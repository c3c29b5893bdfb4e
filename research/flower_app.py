"""Flies examples/flower_app over several radios and writes the table of flower.md; needs the extra `flower`."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.markdown import replaced, table

PAGE = published.DOCS / "flower.md"
APP = published.DOCS.parent / "examples" / "flower_app"
FIRST_SEED = 98301
ROUNDS = (10, 20, 40)  # accuracies that the table has
FLOWN = ("--uavs", "10", "--in-process", "--quiet", "--set", "federation.period=20")
RADIOS: dict[str, tuple[str, ...]] = {
    "loses nothing": ("--set", "radio.model=ideal"),
    "`paper`": (),
    "`paper`, refuse": ("--set", "federation.options.incomplete=refuse"),
    "`paper`, refuse, 3 retries": (
        "--set",
        "federation.options.incomplete=refuse",
        "--set",
        "federation.retries=3",
    ),
    "`lossy`": ("--mission", "lossy"),
    "`lossy`, 1 retry": ("--mission", "lossy", "--set", "federation.retries=1"),
    "`lossy`, 3 retries": ("--mission", "lossy", "--set", "federation.retries=3"),
}


def main() -> None:
    """Fly every case and write the table."""
    given = published.options(__doc__, seeds=3).parse_args()
    rows = []
    for name, flags in RADIOS.items():
        results = [flown(flags, FIRST_SEED + number) for number in range(given.seeds)]
        rows.append(row(name, results))
        print(*rows[-1], flush=True)
    head = (
        "radio",
        *(f"accuracy after {number}" for number in ROUNDS),
        "failures",
        "up, Mbit",
        "down, Mbit",
        "airtime, s",
    )
    lines = [*table(head, rows), "", f"Means of {given.seeds} seeds. {published.flown_by()}"]
    page = replaced(PAGE.read_text(encoding="utf-8"), "<!-- radios -->", "<!-- end -->", ["", *lines, ""])
    PAGE.write_text(page, encoding="utf-8")
    print(PAGE)


def flown(flags: tuple[str, ...], seed: int) -> dict[str, Any]:
    """The result of a flight, which the command flies in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        given = ("--seed", str(seed), "--run-config", f"num-server-rounds={max(ROUNDS)}", "--out", folder)
        subprocess.run(
            [sys.executable, "-m", "meanflock", "flower", str(APP), *FLOWN, *flags, *given],
            check=True,
            env=os.environ | {"PYTHONSAFEPATH": "1"},
            stdout=subprocess.DEVNULL,
        )
        (file,) = Path(folder).glob("2*/result.json")
        result: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        return result


def row(name: str, results: list[dict[str, Any]]) -> tuple[str, ...]:
    """A row of the table."""

    def mean(values: list[float]) -> float:
        return statistics.mean(values).value

    accuracies = [mean([result["rounds"][number - 1]["accuracy"] for result in results]) for number in ROUNDS]
    failures = mean([sum(one["failures"] for one in result["rounds"]) for result in results])
    asked = mean([sum(one["asked"] for one in result["rounds"]) for result in results])
    bits = [
        mean([result["summary"]["payload_bits"][kind] / 1e6 for result in results]) for kind in ("uplink", "broadcast")
    ]
    airtime = mean([result["rounds"][-1]["airtime_s"] for result in results])
    return (
        name,
        *(f"{accuracy:.3f}" for accuracy in accuracies),
        f"{failures / asked:.1%}",
        *(f"{one:.1f}" for one in bits),
        f"{airtime:.2f}",
    )


if __name__ == "__main__":
    main()
