"""`python -m tests.fuzz`, or `make fuzz`: a million mutated messages at one flight, and at flights with a mad node."""

import argparse
import logging
import sys
import time

from rich.console import Console
from rich.table import Table

from tests.fuzz.siege import Broken, Insider, Siege

FLAT = 1.25  # times the memory after a fifth of the messages
MAD = ("agent-0", "leader")


def main() -> int:
    """Returns 1 if a promise was broken, else 0."""
    options = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    options.add_argument("--count", type=int, default=1_000_000, help="messages (default 1000000)")
    options.add_argument("--seed", type=int, default=1)
    given = options.parse_args()
    logging.disable(logging.WARNING)  # every drop would be a line until they are too many
    console = Console(stderr=True)
    started = time.perf_counter()
    broken: list[str] = []
    insiders: dict[str, Insider] = {}
    try:
        with console.status("under fire") as status:
            siege = Siege(
                given.count, given.seed, lambda thrown: status.update(f"{thrown:,} of {given.count:,} messages")
            )
            summary = siege.fly()
            for who in MAD:
                insiders[who] = insider = Insider(given.count // 20, given.seed, who)
                if insider.fly()["ticks"] != summary["ticks"]:
                    broken.append(f"the flight with a mad {who} ended early")
    except Broken as error:
        console.print(f"[red]broken[/] {error}", highlight=False, soft_wrap=True)
        return 1
    if summary["trajectory_sha256"] != siege.expected["trajectory_sha256"]:
        broken.append("the trajectory is not that of the flight in peace")
    memory = [siege.rss[len(siege.rss) // 5] / 2**20, siege.rss[-1] / 2**20]
    if memory[1] > FLAT * memory[0]:
        broken.append(f"memory grew from {memory[0]:.0f} to {memory[1]:.0f} MiB")

    table = Table("", "messages", title=f"{siege.thrown['codec']:,} mutated messages, seed {given.seed}")
    counts = {f"thrown at: {who}": number for who, number in siege.thrown.items()}
    counts |= dict(sorted(siege.outcome.items()))
    counts |= {f"world: {reason}": number for reason, number in sorted(summary["dropped_messages"].items())}
    counts |= {f"mad {who}: ticks in which a mutation was let in": one.let_in for who, one in insiders.items()}
    for what, number in counts.items():
        table.add_row(what, f"{number:,}")
    table.add_row("memory after a fifth, at the end", f"{memory[0]:.0f}, {memory[1]:.0f} MiB")
    table.add_row("time", f"{time.perf_counter() - started:.0f} s")
    Console().print(table)
    for sentence in broken:
        console.print(f"[red]broken[/] {sentence}", highlight=False)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
