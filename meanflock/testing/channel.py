"""The conformance suite of channels."""

from collections.abc import Callable
from typing import Any

import numpy as np

from meanflock.channel.base import Channel, Message, carried, closed_form
from meanflock.swarm import threads
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import random_state, set_random_state
from meanflock.testing.error import (
    GONE,
    OTHER_THREADS,
    THREADS,
    alike,
    asked,
    check_class,
    check_kept,
    fail,
    make,
    same,
    with_surroundings,
)
from meanflock.testing.pace import SLOW_MS, check_pace

UAVS = 25  # of the paper's swarm
BITS = (1, 128, 3456, 7872)
# Number of links of each message, and the longest of them in m: equal messages, other distances, another number, none.
LINKS = ((40, 200.0), (40, 200.0), (40, 90.0), (1, 200.0), (1, 200.0), (1, 90.0), (0, 0.0))
_RANDOM = "draw from the generator you are given"
ALL_LINKS = UAVS * (UAVS - 1)  # to measure the time of a message


@threads.limited()
def check_channel(
    channel: type,
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
) -> None:
    """Sends some messages over a channel and checks everything that the radio relies on.

    A channel that remembers anything but its memory between two messages fails, because checkpoints do not store it.

    Args:
        channel: the class. options: those of the table [radio.options]. scenario: default: the paper's, whose last UAV
            is a station if the channel declares `stations`.
        slow_ms: limit of the median time of a message over 600 links.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(channel, "channel")
    flown = scenario or Scenario()
    if scenario is None and getattr(channel, "stations", False):  # its last node is a station
        flown = Scenario(uavs=UAVS - 1, stations=({"place": (0.0, 0.0, 25.0)},))

    def sent(seed: int, draw: int, afresh: bool = False, number: int = 1) -> list[np.ndarray]:
        def run() -> list[np.ndarray]:
            made, rng = make(channel, options or {}, flown), np.random.default_rng(draw)
            memory = asked(channel, made.init, UAVS, remedy="return a dict of arrays")
            check_kept(channel, "`init`: memory", memory)
            all_sent: list[np.ndarray] = []
            for bits in BITS:
                for tick, (links, longest_m) in enumerate(LINKS):
                    if afresh:  # as after a checkpoint
                        saved, rng = random_state(rng), np.random.default_rng()
                        set_random_state(rng, saved)
                        made = make(channel, options or {}, flown)
                        memory = {name: array.copy() for name, array in memory.items()}
                    message = over(links, longest_m, bits, tick)
                    given, before = message.distance_m.copy(), {name: array.copy() for name, array in memory.items()}
                    remedy = GONE if afresh else f"{links} links must do, as any number"
                    answer = asked(channel, written(made), dict(memory), message, rng, remedy=remedy)
                    if not same(given, message.distance_m):
                        fail(channel, "`transmit` writes to the distances", "copy before you write")
                    if name := alike(before, memory):
                        fail(channel, f"`carry` writes to memory[{name!r}]", "copy before you write")
                    form = asked(channel, made.expected, message.distance_m, bits, remedy=remedy)
                    try:
                        memory, of_links = carried(answer, memory, links)
                        all_sent += map(np.array, of_links)
                        all_sent.append(np.array(closed_form(form, links, "expected") or ()))
                        foreseen = asked(channel, made.foreseen, dict(memory), message, remedy=remedy)
                        all_sent.append(np.array(closed_form(foreseen, links, "foreseen") or ()))
                    except (TypeError, ValueError) as error:
                        fail(channel, f"over {links} links: {error}", "return that")
                    check_kept(channel, "memory", memory)
            return [*all_sent, *memory.values()]

        return with_surroundings(channel, _RANDOM, run, seed, number)

    first = sent(1, 7)
    for again, what, remedy in (
        (sent(2, 7), "the same messages differed in a second run", _RANDOM),
        (sent(1, 7, number=OTHER_THREADS), *THREADS),
        (
            sent(1, 7, afresh=True),
            "messages that continue from a checkpoint differ",
            "keep nothing between two calls, and of `rng` take numbers only",
        ),
    ):
        if not all(same(one, other) for one, other in zip(first, again, strict=True)):
            fail(channel, what, remedy)
    made = make(channel, options or {}, flown)
    try:
        made.check_rate()
    except BadInput as error:
        fail(channel, str(error), "fragments of models are cut by it")
    rng = np.random.default_rng(8)
    memory = made.init(UAVS)
    check_pace(
        channel,
        f"a message over {ALL_LINKS} links",
        slow_ms,
        lambda number: made.carry(memory, over(ALL_LINKS, 200.0, BITS[number % len(BITS)], number), rng),
    )


def written(made: Channel) -> Callable[..., Any]:
    """The method `carry` of a channel, named after the method that the channel's author wrote."""

    def carry(*given: Any) -> Any:
        return made.carry(*given)

    carry.__name__ = "transmit" if type(made).carry is Channel.carry else "carry"
    return carry


def over(links: int, longest_m: float, bits: int, tick: int) -> Message:
    """A message over the first links of a swarm on a spiral, which turns from tick to tick. `longest_m`: the length of
    the longest of all its links.
    """
    source, target = np.nonzero(~np.eye(UAVS, dtype=bool))
    turned = 0.1 * tick + np.arange(UAVS)
    place = np.stack([np.cos(turned), np.sin(turned)], axis=-1) * np.arange(1.0, UAVS + 1)[:, None]
    apart = place[source] - place[target]
    distance = np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2)
    scale = longest_m / distance.max()
    return Message(tick, bits, source[:links], target[:links], scale * distance[:links], scale * place)
