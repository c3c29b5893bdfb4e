"""`python -m tests.fuzz`, or `make fuzz`: a million mutated messages at one flight, and at flights with a mad node.

With `--scenarios 1000` so many random scenarios are flown instead.
"""

import argparse
import json
import logging
import sys

from tests.fuzz import scenarios
from tests.fuzz.siege import Broken, Insider, Siege

FLAT = 1.25  # times the memory after a fifth of the messages
MAD = ("agent-0", "leader")


def main() -> int:
    """Returns 1 if a promise was broken, else 0."""
    options = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    options.add_argument("--count", type=int, default=1_000_000, help="messages (default 1000000)")
    options.add_argument("--scenarios", type=int, help="fly so many random scenarios instead")
    options.add_argument("--seed", type=int, default=1)
    given = options.parse_args()
    logging.disable(logging.WARNING)  # every drop would be a line until they are too many
    if given.scenarios is not None:
        logging.disable(logging.CRITICAL)  # many flights lose UAVs
        is_broken = False
        for line in scenarios.broken(range(given.seed, given.seed + given.scenarios)):
            print(line, flush=True)
            is_broken = True
        return int(is_broken)
    broken: list[str] = []
    siege = Siege(given.count, given.seed)
    insiders = {who: Insider(given.count // 20, given.seed, who) for who in MAD}
    try:
        summary = siege.fly()
        for who, insider in insiders.items():
            if insider.fly()["ticks"] != summary["ticks"]:
                broken.append(f"the flight with a mad {who} ended early")
    except Broken as error:
        print(f"broken: {error}")
        return 1
    if summary["trajectory_sha256"] != siege.expected["trajectory_sha256"]:
        broken.append("the trajectory is not that of the flight in peace")
    first, last = siege.rss[len(siege.rss) // 5] / 2**20, siege.rss[-1] / 2**20
    if last > FLAT * first:
        broken.append(f"memory grew from {first:.0f} to {last:.0f} MiB")
    report = {
        "thrown at": siege.thrown,
        "outcome": siege.outcome,
        "dropped": summary["dropped_messages"],
        "let in, by ticks": {who: insider.let_in for who, insider in insiders.items()},
        "memory, MiB": [first, last],
        "broken": broken,
    }
    print(json.dumps(report, indent=1))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
