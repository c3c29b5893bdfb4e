"""The conformance suite of channels."""

from typing import Any

import numpy as np

from meanflock.channel.base import carried, closed_form
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import random_state, set_random_state
from meanflock.testing.error import asked, check_class, fail, make, same, with_other_randomness
from meanflock.testing.pace import SLOW_MS, check_pace

BITS = (1, 128, 3456, 7872)
# Number of links of each message, and the longest of them in m: equal messages, other distances, another number, none.
LINKS = ((40, 200.0), (40, 200.0), (40, 90.0), (1, 200.0), (1, 200.0), (1, 90.0), (0, 0.0))
ALL_LINKS = 25 * 24  # of the paper's swarm, to measure the time of a message


def check_channel(
    channel: type,
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
) -> None:
    """Sends some messages over a channel and checks everything that the radio relies on.

    A channel that remembers anything between two messages fails, because checkpoints do not store it.

    Args:
        channel: the class. options: those of the table [radio.options]. scenario: default: the paper's.
        slow_ms: limit of the median time of a message over 600 links.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(channel, "channel")
    flown = scenario or Scenario()

    def sent(seed: int, draw: int, afresh: bool = False) -> list[np.ndarray]:
        def run() -> list[np.ndarray]:
            made, rng = make(channel, options or {}, flown), np.random.default_rng(draw)
            all_sent: list[np.ndarray] = []
            for bits in BITS:
                for links, longest_m in LINKS:
                    distance = np.linspace(longest_m, 1.0, links)
                    given = distance.copy()
                    if afresh:  # as after a checkpoint
                        saved, rng = random_state(rng), np.random.default_rng()
                        set_random_state(rng, saved)
                        made = make(channel, options or {}, flown)
                    answer = asked(
                        channel, made.transmit, distance, bits, rng, remedy=f"{links} links must do, as any number"
                    )
                    if not same(given, distance):
                        fail(channel, "`transmit` writes to the distances", "copy before you write")
                    form = asked(channel, made.expected, distance, bits, remedy=f"{links} links must do, as any number")
                    try:
                        all_sent += map(np.array, carried(answer, links))
                        all_sent.append(np.array(closed_form(form) or ()))
                    except (TypeError, ValueError) as error:
                        fail(channel, f"over {links} links: {error}", "return that")
            return all_sent

        return with_other_randomness(run, seed)

    first = sent(1, 7)
    for again, what, remedy in (
        (sent(2, 7), "the same messages differed in a second run", "draw from the generator you are given"),
        (
            sent(1, 7, afresh=True),
            "messages that continue from a checkpoint differ",
            "keep nothing between two calls, and of `rng` take numbers only",
        ),
    ):
        if not all(same(one, other) for one, other in zip(first, again, strict=True)):
            fail(channel, what, remedy)
    made = make(channel, options or {}, flown)
    rng = np.random.default_rng(8)
    distance = np.linspace(1.0, 200.0, ALL_LINKS)
    check_pace(
        channel,
        f"a message over {ALL_LINKS} links",
        slow_ms,
        lambda number: made.transmit(distance, BITS[number % len(BITS)], rng),
    )
