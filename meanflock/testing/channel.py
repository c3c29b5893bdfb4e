"""The conformance suite of channels."""

from typing import Any

import numpy as np

from meanflock.channel.medium import MOST_SLOTS
from meanflock.swarm.failures import FAILURES, last_line
from meanflock.swarm.scenario import Scenario
from meanflock.testing.error import asked, check_class, fail, make, same, with_other_randomness
from meanflock.testing.pace import SLOW_MS, check_pace

LINKS = 40
ALL_LINKS = 25 * 24  # of the paper's swarm, for the time a message takes
BITS = (1, 128, 3456, 7872)
_EXPECTED = "return outages and slots of delivered messages, summed over the links; or None"


def check_channel(
    channel: type,
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
) -> None:
    """Sends some messages and checks everything that the radio relies on.

    Args:
        channel: the class. options: as in the table [radio.options]. scenario: another one than the paper's.
        slow_ms: what a message over 600 links may take, median.

    Raises:
        ConformanceError: a check fails; the text says what to mend.
    """
    check_class(channel, "channel")
    flown = scenario or Scenario()

    def sent(seed: int, draw: int, afresh: bool = False) -> list[np.ndarray]:
        def run() -> list[np.ndarray]:
            made, rng, all_sent = make(channel, options or {}, flown), np.random.default_rng(draw), []
            for bits in BITS:
                for links in (LINKS, 1, 0):
                    distance = np.linspace(1.0, 200.0, links)
                    given = distance.copy()
                    if afresh:
                        made = make(channel, options or {}, flown)
                    try:
                        answer = made.transmit(distance, bits, rng)
                    except FAILURES as error:
                        what = f"`transmit` over {links} links failed: {last_line(error)}"
                        fail(channel, what, "any number of links must do")
                    if not isinstance(answer, tuple) or len(answer) != 2:
                        fail(channel, f"`transmit` returns a {type(answer).__name__}", "return slots and delivered")
                    slots, delivered = answer
                    if not same(given, distance):
                        fail(channel, "`transmit` writes to the distances", "copy before you write")
                    _check(channel, links, np.asarray(slots), np.asarray(delivered))
                    _check_expected(channel, asked(channel, made.expected, distance, bits, mend=_EXPECTED))
                    all_sent += [np.asarray(slots), np.asarray(delivered)]
            return all_sent

        return with_other_randomness(run, seed)

    first = sent(1, 7)
    for again, what, mend in (
        (sent(2, 7), "the same messages came out otherwise a second time", "draw from the generator you are given"),
        (sent(1, 7, afresh=True), "messages of a channel made anew differ", "keep nothing between two calls"),
    ):
        if not all(same(one, other) for one, other in zip(first, again, strict=True)):
            fail(channel, what, mend)
    made, rng, distance = (
        make(channel, options or {}, flown),
        np.random.default_rng(8),
        np.linspace(1.0, 200.0, ALL_LINKS),
    )
    check_pace(
        channel,
        f"a message over {ALL_LINKS} links",
        slow_ms,
        lambda number: made.transmit(distance, BITS[number % len(BITS)], rng),
    )


def _check(channel: type, links: int, slots: np.ndarray, delivered: np.ndarray) -> None:
    if slots.shape != (links,) or delivered.shape != (links,):
        came = f"shapes {slots.shape} and {delivered.shape}"
        fail(channel, f"`transmit` over {links} links returns {came}", "return slots (K,) and delivered (K,)")
    if slots.dtype.kind != "i" or delivered.dtype != bool:
        came = f"{slots.dtype} and {delivered.dtype}"
        fail(channel, f"`transmit` returns {came}", "return slots as int64 and delivered as bool")
    if (slots < 1).any():
        fail(channel, "a message takes no slot at all", "a message takes one slot at least, lost ones too")
    if (slots > MOST_SLOTS).any():
        fail(channel, f"a message takes {slots.max()} slots", f"at most {MOST_SLOTS}")


def _check_expected(channel: type, expected: Any) -> None:
    if expected is None:
        return
    try:
        outages, slots = expected
        fine = bool(np.isfinite([float(outages), float(slots)]).all())
    except FAILURES:
        fine = False
    if not fine:
        fail(channel, f"`expected` returns {expected!r}", _EXPECTED)
