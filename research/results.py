"""Flies the results of the documentation again, in parts, and writes their pages.

make results                    # lists the parts
make results ARGS=federation    # flies a part; a repeated command flies only what is missing
make results ARGS="leaderboard-half leaderboard"

Each part takes an hour at most on two cores, if the parts that it goes on from flew before.
"""

import argparse
import shlex
import subprocess
import sys
from collections.abc import Sequence
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from meanflock.net import process
from meanflock.studies import published
from meanflock.swarm.errors import BadInput, RunFailed

ROOT = published.DOCS.parent
BOARD = "-m meanflock leaderboard --first-seed 195001 --out out/leaderboard"
HALF = "--missions paper windy unknown gusts lossy obstacles swap"  # of the time, not of their number
PAPER = "-m meanflock paper --out out/paper"
JUDGED = "out/paper out/paper-slow out/paper-printed out/paper-exchanged"  # folders, in the order of the pages


class Reflown(NamedTuple):
    """Results that fly together. about: what it shows. commands: of Python, one after the other; each goes on where an
    interrupted one ended."""

    about: str
    commands: tuple[str, ...]


PARTS = {
    "federation": Reflown(
        "ways of sharing a model, in bands of their own and in one band", ("-m research.federation",)
    ),
    "one-band": Reflown("models and states of which all use one band", ("-m research.one_band",)),
    "communication": Reflown("narrow payloads and thresholds", ("-m research.communication",)),
    "clusters": Reflown("one leader or heads of clusters", ("-m research.clusters",)),
    "robustness": Reflown("malicious UAVs and false states", ("-m research.robustness", "-m research.false_states")),
    "free-flights": Reflown("flights behind the filter, without a collision", ("-m research.free_flights",)),
    "leaderboard-half": Reflown("all controllers in half of the missions; `leaderboard` goes on", (f"{BOARD} {HALF}",)),
    "leaderboard": Reflown("all controllers in all missions", (BOARD, "docs/leaderboard.py out/leaderboard")),
    "price-of-safety": Reflown(
        "the fewest bits for flights without collisions",
        (
            "-m meanflock frontier --first-seed 294001 --out out/frontier",
            "-m meanflock.studies.frontier out/frontier",
            "-m meanflock.studies.equal_bits",
        ),
    ),
    "reproduction-paper": Reflown("the paper's claims, in its scenario; `reproduction` goes on", (PAPER,)),
    "reproduction": Reflown(
        "the paper's claims, in four scenarios",
        (
            PAPER,
            "-m meanflock paper --scenario paper-slow --seeds 10 --out out/paper-slow",
            "-m meanflock paper --scenario paper-printed --seeds 10 --out out/paper-printed",
            "-m meanflock paper --scenario paper-exchanged --seeds 6 --out out/paper-exchanged",
            f"-m research.reproduction.page {JUDGED}",
            f"-m research.reproduction.structural_page {JUDGED}",
        ),
    ),
    "space": Reflown("the plane and space", ("-m research.plane_and_space",)),
    "round-cost": Reflown("the cost of a round on radios of today", ("-m research.round_cost",)),
    "mean-field-limit": Reflown("swarms of 10 to 100,000 UAVs", ("-m research.mean_field_limit --jobs 1",)),
    "price-of-accuracy": Reflown(
        "what 90 % accuracy costs in bits, airtime, joules and seconds", ("-m research.price_of_accuracy",)
    ),
    "flower": Reflown("a Flower app on three radios", ("-m research.flower_app",)),
    "scaling": Reflown(
        "times of large swarms; alone on the machine",
        ("-m benchmarks --only scale scale_processes --json benchmarks/scaling.json", "-m benchmarks.scaling"),
    ),
    "performance": Reflown("races with peers, which `make peers` installs; alone on the machine", ("-m benchmarks",)),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Fly the named parts in turn, or list all.

    Raises:
        BadInput: no part has the name. RunFailed: a command failed; the parts before it are written.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help="a part; none: list all")
    given = parser.parse_args(arguments)
    if unknown := [name for name in given.parts if name not in PARTS]:
        raise BadInput(f"no part is called {', '.join(unknown)}; there are {', '.join(PARTS)}")
    if not given.parts:
        listed = Table("part", "what it shows", box=None)
        for name, part in PARTS.items():
            listed.add_row(name, part.about)
        Console().print(listed)
    for name in given.parts:
        for command in PARTS[name].commands:
            print(f"{name}: python {command}", file=sys.stderr, flush=True)
            if code := subprocess.run([sys.executable, *shlex.split(command)], cwd=ROOT).returncode:
                raise RunFailed(f"{name}: python {command} ended with exit code {code}; repeat the part to go on")


if __name__ == "__main__":
    process.main(main)
