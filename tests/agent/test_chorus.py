"""A tick in which everyone is heard by reflex is that tick the long way, to the last bit; what else comes is left."""

from collections.abc import Iterable

import numpy as np
import pytest

from agent.chorus import Chorus
from agent.node import Agent
from swarm import codec, keys, plain, scenario, state
from swarm.codec import FLOAT_OF_BITS
from swarm.messages import FrameKind, Frames, Sense, Welcome
from swarm.model import BEYOND_SENSE
from swarm.scenario import Scenario, load
from worldsim.formation import initial_states

NUMBER, UAVS = keys.fingerprint("chorus-test"), 6
ROWS = [tuple(range(UAVS)), (1,), (2, 3, 5)]


def agent(of: Scenario, rows: tuple[int, ...]) -> Agent:
    plan = initial_states(of).astype(FLOAT_OF_BITS[of.radio.bits_per_float])
    return Agent(Welcome(NUMBER, "agent", rows, 0, scenario.encode(of), plan))


def flown(*settings: str) -> Scenario:
    return load(None, [f"uavs={UAVS}", *settings], method="hjb")


def sense(of: Scenario, rows: tuple[int, ...], tick: int, lost: Iterable[int] = (), scale: float = 1.0) -> Sense:
    """What a node is asked when every UAV spoke, but for links that lost their message; every tenth with a report."""
    states = scale * np.random.default_rng(tick).uniform([0, 0, -5, -5], [160, 110, 5, 5], (UAVS, state.SIZE))
    with np.errstate(over="ignore"):
        said = states.astype(FLOAT_OF_BITS[of.radio.bits_per_float])
    links = np.array([(u, v) for u in range(UAVS) for v in rows if u != v], dtype=np.int32)
    links = np.delete(links, list(lost), axis=0)
    source, row = np.unique(links[:, 0], return_inverse=True)
    links = np.stack([row, links[:, 1]], axis=-1).astype(np.int32)
    inbox = (Frames(FrameKind.STATE, 0, source.astype(np.int32), said[source], links),) if len(links) else ()
    return Sense(NUMBER, tick, states[list(rows)], tick % 10 == 0, inbox)


def lost_in(tick: int, links: int) -> list[int]:
    """No link, one, any of them, or two, from tick to tick."""
    return [[], [tick % links], [links - 1], [0], [0, links // 2]][tick % 5]


@pytest.mark.parametrize("rows", ROWS, ids=len)
@pytest.mark.parametrize("bits", [16, 32, 64])
def test_a_flight_by_reflex_is_the_flight_the_long_way(rows: tuple[int, ...], bits: int) -> None:
    of = flown(f"radio.bits_per_float={bits}")
    quick, slow, reflexes = agent(of, rows), agent(of, rows), 0
    for tick in range(1, 300):
        asked = sense(of, rows, tick, lost_in(tick, len(rows) * (UAVS - 1)))
        raw = codec.encode(asked)
        answer = quick.reflex(raw, tick)
        reflexes += answer is not None
        assert plain.encode(asked) == raw
        assert (answer or codec.encode(quick.act(asked))) == codec.encode(slow.act(asked))
        assert quick._known is not None
        assert slow._known is not None
        assert quick._known.tobytes() == slow._known.tobytes()
    assert reflexes == (59 if len(rows) == 1 else 239)  # of whom a node of one hears nothing, nothing is in its Sense


def changed(asked: Sense, **fields: np.ndarray) -> Sense:
    frames = {name: getattr(asked.inbox[0], name) for name in ("source", "payload", "links")} | fields
    return Sense(NUMBER, asked.tick, asked.states, False, (Frames(FrameKind.STATE, 0, **frames),))


def test_what_is_not_plain_is_left_and_nothing_is_known_of_it() -> None:
    of, rows = flown(), ROWS[0]
    node, good = agent(of, rows), sense(of, rows, 3)
    assert node._known is not None
    before = node._known.tobytes()
    (frames,) = good.inbox
    assert frames.links is not None
    swapped, twice = frames.links.copy(), frames.links[:-1].copy()
    swapped[[0, 1]], twice[1] = swapped[[1, 0]], twice[0]
    infinite = frames.payload.copy()
    infinite[2, 1] = np.inf
    others = {
        "another order": codec.encode(changed(good, links=swapped)),
        "a link twice": codec.encode(changed(good, links=twice)),
        "a link beyond": codec.encode(changed(good, links=frames.links + 7)),
        "other sources": codec.encode(changed(good, source=frames.source + 1)),
        "not finite": codec.encode(changed(good, payload=infinite)),
        "two lost": codec.encode(sense(of, rows, 3, [3, 9])),
        "nobody spoke": codec.encode(Sense(NUMBER, 3, good.states, False)),
        "a checkpoint": codec.encode(Sense(NUMBER, 3, good.states, False, good.inbox, checkpoint=True)),
        "cut": codec.encode(good)[:-1],
        "longer": codec.encode(good) + b"\xc2",
        "nothing": b"",
    }
    for what, raw in others.items():
        assert node.reflex(raw, 3) is None, what
        assert node._known.tobytes() == before, what
    assert node.reflex(codec.encode(good), 4) is None
    assert node.reflex(codec.encode(good), 3) == codec.encode(agent(of, rows).act(good))


def test_states_the_radio_cannot_carry_and_numbers_beyond_all_bounds_take_the_long_way() -> None:
    for settings, scale in ((("radio.bits_per_float=16",), 1e4), ((), BEYOND_SENSE)):
        of = flown(*settings)
        quick, slow = agent(of, ROWS[0]), agent(of, ROWS[0])
        heard = sense(of, ROWS[0], 1).inbox
        asked = Sense(NUMBER, 1, sense(of, ROWS[0], 1, scale=scale).states, False, heard)
        assert quick.reflex(codec.encode(asked), 1) is None
        assert codec.encode(quick.act(asked)) == codec.encode(slow.act(asked))


def test_where_uavs_are_paused_no_tick_is_plain() -> None:
    pause = {"kind": "pause", "uavs": [0], "time_s": 3.0, "duration_s": 1.0}
    of = load(None, [f"uavs={UAVS}"], method="hjb", faults=[pause])
    assert agent(of, ROWS[0]).reflex(codec.encode(sense(of, ROWS[0], 3)), 3) is None


def test_a_chorus_lacks_one_link_at_the_most_and_has_few_enough_to_lack_no_more() -> None:
    assert plain.chorus_links(3, 8) == (21, 20)
    assert plain.chorus_links(1, 7) == (7,)  # who loses the only link is not heard
    assert plain.chorus_links(1, 0) == ()
    assert plain.chorus_links(71, 71) == (4970, 4969)
    assert plain.chorus_links(72, 72) == ()
    assert Chorus.serves(1, 1000)
    assert not Chorus.serves(1, 1)
    assert not Chorus.serves(100, 100)
