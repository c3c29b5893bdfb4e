"""`python -m tests.soak`, or `make soak`: a long flight on processes that are killed, frozen and started again."""

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from tests.soak.soak import Soak


def main() -> int:
    """Returns 1 if a promise was broken, else 0."""
    options = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    options.add_argument("--ticks", type=int, default=10_000, help="length of the flight (default 10000)")
    options.add_argument("--uavs", type=int, default=9, help="agents (default 9)")
    options.add_argument("--every", type=int, default=50, help="ticks between two mishaps, on average (default 50)")
    options.add_argument("--seed", type=int, default=1, help="of the flight and the mishaps")
    given = options.parse_args()
    if given.ticks < 300 or given.uavs < 5 or given.every < 1:
        options.error("a soak needs --ticks of 300 or more, --uavs of 5 or more and --every of 1 or more")
    with tempfile.TemporaryDirectory(prefix="meanflock-soak-") as out:
        report = Soak(given.uavs, given.ticks, given.every, given.seed, Path(out)).run()
    print(json.dumps(asdict(report), indent=1))
    return 1 if report.broken else 0


if __name__ == "__main__":
    sys.exit(main())
