"""The compiled radio gives the bits of NumPy's, whatever is sent over it; and what does not fit it is refused."""

import shutil
import sysconfig
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from channel import kernel, link
from channel.account import account
from channel.air import Air
from channel.fading import Fading
from channel.link import Transmission, bits_per_slot, transmit
from channel.links import Links
from groundstation.engine import Engine
from groundstation.paper.batch import Batch
from swarm import normals, state
from swarm.messages import FrameKind, Telemetry
from swarm.scenario import Radio, load

needs_kernel = pytest.mark.skipif(not kernel.is_compiled(), reason="installed without a C compiler")
BOTH = (True, False)


def radio(*changes: str) -> Radio:
    return load(None, [f"radio.{change}" for change in changes]).radio


def bits(*numbers: Any) -> list[Any]:
    """To be compared to the last bit, and the kind of number with it."""
    return [(n.dtype.str, n.shape, n.tobytes()) if isinstance(n, np.ndarray) else (type(n), n) for n in numbers]


def test_where_there_is_a_compiler_there_is_a_kernel() -> None:
    headers = Path(sysconfig.get_path("include"), "Python.h")
    assert kernel.is_compiled() or shutil.which("cc") is None or not headers.exists()


# -- a message ----------------------------------------------------------------------------------------------------

THRESHOLDS = st.sampled_from([0.0, -0.0, 1e-300, 20.0, 40.0, 47.0, 60.0, 90.0, np.inf])
MESSAGES = st.tuples(
    st.integers(0, 400),  # links
    st.one_of(THRESHOLDS, st.lists(THRESHOLDS, min_size=1, max_size=7)),  # for all, or link by link, over and over
    st.integers(1, 12),  # slots needed
    st.integers(1, 40),  # slots at most
)


@needs_kernel
@settings(max_examples=200, deadline=None)
@given(st.lists(MESSAGES, max_size=6), st.sampled_from([1, 7, 64, 4096]), st.integers(0, 3))
@example([(600, 47.0, 1, 8)] * 4, 4096, 0)
def test_messages_of_the_kernel_are_those_of_numpy(messages: list[Any], block: int, seed: int) -> None:
    """One after the other through the same fading, whatever is drawn at a time."""
    given_radio, said = radio("rice_xi=6.0", "rice_chi=1.5"), []
    for carry in (kernel.carry, link._carry):
        with patch.object(normals, "_BLOCK", block):
            drawn, results = Fading(np.random.default_rng(seed), given_radio), []
            for links, each, needed, most in messages:
                threshold = np.resize(each, links) if isinstance(each, list) else np.array([each])
                results += bits(*carry(drawn, threshold, links, needed, most))
                results.append(drawn.snapshot())
        said.append(results)
    assert said[0] == said[1]


@needs_kernel
@pytest.mark.parametrize("needed", [1, 2, 5, 9])
@pytest.mark.parametrize("links", [0, 1, 24, 600, 9000])
@pytest.mark.parametrize(
    "changes",
    [
        (),
        ("target_snr_db=76",),
        ("latency_threshold_slots=1",),
        ("path_loss_exponent=2", "target_snr_db=36"),
        ("path_loss_exponent=2.7", 'fading="power"', "target_snr_db=30"),
        ("rice_xi=0", "target_snr_db=69", "latency_threshold_slots=60"),
    ],
)
def test_a_transmission_is_the_same_on_every_radio(changes: tuple[str, ...], links: int, needed: int) -> None:
    by = radio(*changes)
    metres = np.random.default_rng(2).uniform(0.0, 150.0, links)
    length, said = int(needed * bits_per_slot(by)), []
    for compiled in BOTH:
        drawn = Fading(np.random.default_rng(3), by)
        sent = [transmit(by, drawn, metres, length, compiled=compiled) for _ in range(3)]
        said.append([bits(*one) for one in sent] + [drawn.snapshot()])
    assert said[0] == said[1]


# -- what a batch came to -----------------------------------------------------------------------------------------


@needs_kernel
@settings(deadline=None)
@given(st.sampled_from(FrameKind), st.data())
def test_an_account_of_the_kernel_is_that_of_numpy(kind: FrameKind, data: st.DataObject) -> None:
    uavs = data.draw(st.integers(1, 12))
    wanted = data.draw(arrays(np.bool_, (uavs, uavs)))
    if kind in (FrameKind.UPLOAD, FrameKind.RELAY):
        wanted = wanted & (np.cumsum(wanted, axis=1) == 1)  # a link each
    row, target = wanted.nonzero()
    links = Links.of(kind, np.arange(uavs), row, target, uavs)
    counts = arrays(np.int64, len(links.pair), elements=st.integers(0, 3))
    sent = Transmission(data.draw(counts), data.draw(counts))
    before = links.record.copy()
    one, other = (account(17, links, sent, compiled=compiled) for compiled in BOTH)
    assert bits(*one) == bits(*other)
    np.testing.assert_array_equal(links.record, before)
    assert not np.shares_memory(one.record, links.record)


@needs_kernel
@settings(deadline=None)
@given(
    arrays(
        np.float64,
        st.tuples(st.integers(1, 9), st.just(state.SIZE)),
        elements=st.sampled_from([0.0, -0.0, 30.0, 60.0, -40.0, 1e-9, 100.0, 1e200, np.inf, -np.inf, np.nan]),
    )
)
def test_who_is_together_is_so_both_ways(states: np.ndarray) -> None:
    air = Air(load(None, [f"uavs={len(states)}"]))
    with np.errstate(all="ignore"):
        compiled = air._are_together(states)
        assert air._are_together(np.repeat(states, 2, axis=0)[::2]) == compiled
        with patch.object(kernel, "_kernel", None):
            plain = air._are_together(states)
    assert compiled is plain


# -- whole flights ------------------------------------------------------------------------------------------------


class Story:
    """A sink that keeps all that was told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def write(self, block: Telemetry) -> None:
        """Every array of a block."""
        self.told += bits(*(getattr(block, name) for name in ("states", "status", "swarm", "links", "reports")))


FAULTS = """faults=[{kind='jam',tick=20,duration_s=3.0,centre=[60.0,40.0],radius_m=40.0},
    {kind='partition',tick=45,duration_s=2.0,uavs=[1,4]},{kind='kill',tick=70,uavs=[2]},
    {kind='pause',tick=80,duration_s=1.0,uavs=[0,5]}]"""
LOSSY = ("radio.path_loss_exponent=2", "radio.target_snr_db=40")
SLOW = ("radio.coherence_time_s=0.04", "radio.bandwidth_hz=2500", "radio.target_snr_db=104")  # several ticks a message


@needs_kernel
@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf", "mfgfl-h"])
@pytest.mark.parametrize(
    "changes",
    [
        (),
        (FAULTS,),
        LOSSY,
        (*LOSSY, FAULTS, "start.spacing=30"),
        SLOW,
        ("radio.target_snr_db=76.5", "federation.clusters=3", FAULTS),
        ("uavs=1",),
    ],
)
def test_whole_flights_tell_the_same_story(
    method: str, changes: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    if method == "hjb":
        changes = tuple(change for change in changes if "clusters" not in change)
    flown = load(None, ["uavs=9", "duration=12", "federation.period=15", *changes], method=method)
    ends = []
    for _ in BOTH:
        engine = Engine(flown, "kernel-test", sinks=[story := Story()])
        for _ in engine.fly():
            pass
        record = engine.world.finish()
        record = {name: value for name, value in record.items() if name not in ("wall_time_s", "real_time_factor")}
        air = engine.world.air.snapshot()
        ends.append((record, air["draw"], air["meter"]["traffic"], bits(air["meter"]["links"]), story.told))
        monkeypatch.setattr(kernel, "_kernel", None)
    assert ends[0] == ends[1]
    assert ends[0][4]


@needs_kernel
@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_a_batch_is_the_same_without_the_kernel(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = load(None, ["uavs=6", "duration=6", "federation.period=15", "radio.target_snr_db=77"], method=method)
    ends = []
    for _ in BOTH:
        records = [one.summary for one in Batch(flown, (1, 2, 3)).fly()]
        ends.append([(record["trajectory_sha256"], record["radio"]) for record in records])
        monkeypatch.setattr(kernel, "_kernel", None)
    assert ends[0] == ends[1]


# -- what is handed to the module itself --------------------------------------------------------------------------

LINKS = 5


def numbers(count: int = LINKS, value: int = 7) -> np.ndarray:
    return np.full(count, value, dtype=np.int64)


def to_carry() -> list[Any]:
    normal = np.random.default_rng(4).standard_normal((40, 2))
    return [normal, 6.649, 1.347, np.array([47.0]), 1, 8, False, numbers(), numbers()]


def to_account() -> list[Any]:
    record = np.full((LINKS, 5), 7, dtype=np.int32)
    return [record.copy(), 3, numbers(), numbers(value=0), np.array([0, 2, 4]), record]


WRONG: list[tuple[str, int, Any, str]] = [
    ("carry", 0, np.zeros((4, 2), dtype=np.float32), "normal"),
    ("carry", 0, np.zeros(7), "normal"),
    ("carry", 0, np.zeros((8, 4))[:, :2], "contiguous"),
    ("carry", 3, np.zeros(LINKS - 1), "threshold"),
    ("carry", 3, np.zeros(0), "threshold"),
    ("carry", 3, np.zeros(LINKS, dtype=np.int64), "threshold"),
    ("carry", 7, numbers(LINKS + 1), "missing"),
    ("carry", 7, np.zeros(LINKS), "slots"),
    ("carry", 7, np.zeros(LINKS, dtype=np.int32), "slots"),
    ("carry", 8, numbers(LINKS - 1), "missing"),
    ("carry", 8, bytes(8 * LINKS), "(?i)writable"),
    ("account", 0, np.zeros((LINKS, 4), dtype=np.int32), "template"),
    ("account", 0, np.zeros((LINKS, 5), dtype=np.int64), "template"),
    ("account", 2, numbers(LINKS - 1), "missing"),
    ("account", 2, numbers(value=-1), "slots"),
    ("account", 2, numbers(value=2**31), "slots"),
    ("account", 2, numbers(value=2**63 - 1), "slots"),
    ("account", 2, numbers(value=-(2**63)), "slots"),
    ("account", 3, np.zeros(LINKS, dtype=np.bool_), "missing"),
    ("account", 4, np.array([0, 2, LINKS]), "first"),
    ("account", 4, np.array([0, 2, 2]), "first"),
    ("account", 4, np.array([0, 3, 1]), "first"),
    ("account", 4, np.array([1, 3]), "first"),
    ("account", 4, np.array([-1, 3]), "first"),
    ("account", 4, np.array([0, 2**62]), "first"),
    ("account", 4, np.zeros(0, dtype=np.int64), "first"),
    ("account", 4, np.array([0.0]), "first"),
    ("account", 5, np.zeros((LINKS + 1, 5), dtype=np.int32), "record"),
    ("account", 5, bytes(20 * LINKS), "(?i)writable"),
    ("within", 0, np.zeros((3, 3)), "states"),
    ("within", 0, np.zeros((3, 4), dtype=np.float32), "states"),
    ("within", 0, np.zeros((3, 8))[:, :4], "contiguous"),
]
GOOD = {"carry": to_carry, "account": to_account, "within": lambda: [np.zeros((3, 4)), 1.0]}
WRITTEN = {"carry": (7, 8), "account": (5,), "within": ()}


@needs_kernel
@pytest.mark.parametrize(("name", "place", "wrong", "said"), WRONG)
def test_what_does_not_fit_is_refused_before_anything_is_written(name: str, place: int, wrong: Any, said: str) -> None:
    good = GOOD[name]()
    taken = [*good[:place], wrong, *good[place + 1 :]]
    with pytest.raises((ValueError, BufferError), match=said):
        getattr(kernel._kernel, name)(*taken)
    assert all((good[k] == 7).all() for k in WRITTEN[name] if k != place)


@needs_kernel
def test_numbers_that_make_no_sense_do_no_harm() -> None:
    """Slots beyond all slots, a message that has begun long ago, the same array twice, an index that is overwritten."""
    extremes = np.array([-(2**63), 2**63 - 1, 0, 1, -1])
    for begun in BOTH:
        for needed, most in ((2**62, 2**62), (-5, 3), (1, -1), (1, 0)):
            good = to_carry()
            used, busy = kernel._kernel.carry(*good[:4], needed, most, begun, extremes.copy(), extremes[::-1].copy())
            assert 0 <= used <= 40
            assert 0 <= busy <= LINKS
            used, busy = kernel._kernel.carry(*good[:4], needed, most, begun, same := extremes.copy(), same)
            assert 0 <= used <= 40
    record = np.zeros((LINKS, 5), dtype=np.int32)
    first = record.reshape(-1)[4:8].view(np.int64)
    first[:] = 0, 2
    kernel._kernel.account(record, 2**31 - 1, numbers(value=2**31 - 2), numbers(value=0), first, record)
    assert (record[:, 4] == 2**31 - 2).all()


@needs_kernel
@pytest.mark.parametrize("links", [2**58, 2**59, 2**60 - 1])
def test_absurd_counts_are_refused_before_anything_is_read(links: int) -> None:
    """Arrays that claim more numbers than there is memory, whose records would have more bytes than 64 bits count."""
    here = numbers()
    claimed = np.lib.stride_tricks.as_strided(here, (links,), (8,))
    nothing = np.zeros((0, 5), dtype=np.int32)
    with pytest.raises(ValueError, match=r"template|slots"):
        kernel._kernel.account(nothing, 1, claimed, claimed, np.array([0]), nothing.copy())
    with pytest.raises((ValueError, MemoryError)):
        kernel._kernel.carry(np.zeros((0, 2)), 1.0, 1.0, np.ones(1), 1, 8, True, claimed, claimed)
    assert (here == 7).all()


@pytest.mark.parametrize("snr_db", [-300, -150, -100])
def test_a_radio_on_which_nothing_ever_gets_through_flies(snr_db: int) -> None:
    absurd = ["radio.bandwidth_hz=1", "radio.coherence_time_s=1e-9", f"radio.target_snr_db={snr_db}"]
    flown = load(None, ["uavs=3", "duration=2.5", "federation.period=10", *absurd])
    for compiled in BOTH:
        with patch.object(kernel, "is_compiled", return_value=compiled and kernel.is_compiled()):
            engine = Engine(flown, "absurd")
            for _ in engine.fly():
                pass
            radio = engine.world.finish()["radio"]
            assert radio["outages"] == radio["sent"] > 0


@needs_kernel
def test_nothing_is_written_beyond_the_last_link() -> None:
    """The arrays given are the beginnings of longer ones."""
    for name in ("carry", "account"):
        good = GOOD[name]()
        longer = {k: np.concatenate([good[k], good[k]]) for k in WRITTEN[name]}
        taken = [longer[k][: len(longer[k]) // 2] if k in longer else one for k, one in enumerate(good)]
        getattr(kernel._kernel, name)(*taken)
        assert all((array[len(array) // 2 :] == 7).all() for array in longer.values())
        assert not any((taken[k] == 7).all() for k in longer)


@needs_kernel
def test_no_links_are_no_work() -> None:
    nothing, none = numbers(0), np.zeros((0, 5), dtype=np.int32)
    assert kernel._kernel.carry(np.zeros((0, 2)), 1.0, 1.0, np.ones(1), 1, 8, False, nothing, nothing) == (0, 0)
    assert kernel._kernel.account(none, 1, nothing, nothing, nothing, none) == (0, 0, 0)
