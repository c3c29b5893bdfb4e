"""A plain tick by reflex is the tick the long way, to the last bit; and what is not plain is not answered by reflex."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent import kernel
from agent.node import Agent
from swarm import codec, keys, model, payload, scenario, state
from swarm.codec import FLOAT_OF_BITS
from swarm.errors import MessageRejected
from swarm.messages import Act, FrameKind, Frames, Sense, Welcome
from swarm.methods import Method
from swarm.model import MODEL_FLOATS
from swarm.scenario import Scenario, load
from worldsim.formation import initial_states

NUMBER = keys.fingerprint("reflex-test")
DENSITIES = [method for method in Method if method.learns_density]
FEDERATED = [method for method in Method if method.is_federated]

pytestmark = pytest.mark.skipif(not kernel.is_compiled(), reason="installed without a C compiler")


def flown(method: Method = Method.MFGFL_HF, *settings: str) -> Scenario:
    return load(None, ["uavs=8", "federation.period=5", *settings], method=str(method))


def agent(of: Scenario, rows: int = 3, models: np.ndarray | None = None) -> Agent:
    plan = initial_states(of).astype(FLOAT_OF_BITS[of.radio.bits_per_float])
    return Agent(Welcome(NUMBER, "agent-0", tuple(range(rows)), 0, scenario.encode(of), plan, models))


def states_at(tick: int, rows: int = 3) -> state.States:
    return np.random.default_rng(tick).uniform([0, 0, -5, -5], [160, 110, 5, 5], (rows, state.SIZE))


def sense(tick: int, rows: int = 3, **more: object) -> Sense:
    return Sense(NUMBER, tick, states_at(tick, rows), **({"report": False} | more))  # type: ignore[arg-type]


def minds(of: Agent, tick: int) -> bytes:
    report = of.act(sense(tick, len(of.uavs), report=True)).report
    assert report is not None
    return report.tobytes()


GLOBAL = Frames(
    FrameKind.GLOBAL,
    1,
    np.zeros(1, np.int32),
    np.ones((1, MODEL_FLOATS), np.float32),
    np.array([[0, 0]], np.int32),
)


def brought(of: Scenario, number: int, rows: int, source: int | None = None) -> Frames:
    """A global model as it comes to every row of a node."""
    coding = payload.broadcast(of)
    sent = coding.encode(np.random.default_rng(number).normal(size=(1, coding.floats)))
    links = np.array([[0, row] for row in range(rows)], np.int32)
    leader = np.array([of.federation.leader if source is None else source], np.int32)
    return Frames(FrameKind.GLOBAL, number, leader, sent, links)


@pytest.mark.parametrize("method", DENSITIES)
@pytest.mark.parametrize("rows", [1, 3, 8])
def test_a_flight_by_reflex_is_the_flight_the_long_way(method: Method, rows: int) -> None:
    of = flown(method)
    quick, slow, reflexes = agent(of, rows), agent(of, rows), 0
    for tick in range(300):
        number, since = divmod(tick, 5)
        inbox = (brought(of, number, rows),) if number and since == 2 and method.is_federated else ()
        asked = sense(tick, rows, report=tick % 10 == 0, inbox=inbox)
        expected = codec.encode(slow.act(asked))
        answer = quick.reflex(codec.encode(asked), tick)
        reflexes += answer is not None
        assert (answer or codec.encode(quick.act(asked))) == expected
    assert minds(quick, 300) == minds(slow, 300)
    assert reflexes == 300


@pytest.mark.parametrize("tick", [0, 127, 128, 255, 256, 2**16 - 1, 2**16, 2**32 - 1, 2**32, 2**63 - 1])
def test_a_tick_is_numbered_as_the_codec_does_it(tick: int) -> None:
    quick, slow = agent(flown(Method.MFG)), agent(flown(Method.MFG))
    asked = msgspec.structs.replace(sense(0), tick=tick)
    assert quick.reflex(codec.encode(asked), tick + 1) is None
    assert quick.reflex(codec.encode(asked), tick) == codec.encode(slow.act(asked))


CODINGS = {
    "doubles": ("radio.bits_per_float=64",),
    "doubles, uploaded as floats": (
        "radio.bits_per_float=64",
        "federation.payload=float32",
        "federation.error_feedback=false",
    ),
    "halves": ("federation.payload=float16", "federation.broadcast_payload=float16"),
    "bytes": ("federation.payload=int8", "federation.broadcast_payload=int8"),
    "bytes, and what they lose is lost": ("federation.payload=int8", "federation.error_feedback=false"),
    "falsehoods": ("federation.byzantine_fraction=0.4", "federation.byzantine_kind=noise"),
    "some": ("federation.fraction=0.4",),
}


OPENS, HEARS = 0, 2  # ticks of a round that take the long way
LONG: dict[str, tuple[int, ...]] = {
    "doubles": (),
    "doubles, uploaded as floats": (),
    "halves": (OPENS, HEARS),
    "bytes": (OPENS, HEARS),
    "bytes, and what they lose is lost": (OPENS,),
    "falsehoods": (OPENS,),
    "some": (),
}


@pytest.mark.parametrize("rows", [1, 4])
@pytest.mark.parametrize("how", CODINGS)
def test_rounds_by_reflex_are_rounds_the_long_way_however_models_are_written(how: str, rows: int) -> None:
    of = flown(Method.MFGFL_HF, *CODINGS[how])
    quick, slow = agent(of, rows), agent(of, rows)
    for tick in range(60):
        number, since = divmod(tick, 5)
        inbox = (brought(of, number, rows),) if number and since == 2 else ()
        asked = sense(tick, rows, report=tick % 10 == 0, inbox=inbox)
        answer = quick.reflex(codec.encode(asked), tick)
        assert answer is not None or since in LONG[how]
        assert (answer or codec.encode(quick.act(asked))) == codec.encode(slow.act(asked))
    last = sense(60, rows, report=True, checkpoint=True)
    assert codec.encode(quick.act(last)) == codec.encode(slow.act(last))


WIDTHS = {
    "floats": (),
    "doubles": ("radio.bits_per_float=64",),
    "both": CODINGS["doubles, uploaded as floats"],
}
ROUNDED = np.array([1e-40, 1e-46, 5e-324, -0.0, 1 + 2.0**-24, 1 + 3 * 2.0**-24, -(2.0**-126), 1 / 3])


@st.composite
def learned(draw: st.DrawFn, rows: int) -> np.ndarray:
    """Models (rows, 246) of all sizes."""
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    models = random.normal(size=(rows, MODEL_FLOATS)) * draw(st.sampled_from([1e-30, 1e-3, 1.0, 1e3]))
    models[random.random(models.shape) < 0.1] = draw(st.sampled_from(ROUNDED))
    return models


@settings(max_examples=150, deadline=None, database=None)
@given(st.data())
def test_an_upload_and_a_global_model_come_to_what_they_are_the_long_way(data: st.DataObject) -> None:
    method, width = data.draw(st.sampled_from(FEDERATED)), data.draw(st.sampled_from(sorted(WIDTHS)))
    rows, fraction = data.draw(st.integers(1, 8)), data.draw(st.sampled_from([0.2, 0.5, 1.0]))
    of = flown(method, f"federation.fraction={fraction}", *WIDTHS[width])
    models = data.draw(learned(rows))
    quick, slow = agent(of, rows, models), agent(of, rows, models)
    tick = 5 * data.draw(st.sampled_from([1, 2, 25, 26, 127, 128, 13108]))  # numbers of one byte to three
    for since in (data.draw(st.sampled_from([0, 1, 4])), 2, 3):
        inbox = (brought(of, tick // 5, rows),) if since == 2 else ()
        asked = sense(tick + since, rows, report=data.draw(st.booleans()), inbox=inbox)
        act = slow.act(asked)
        answer = quick.reflex(codec.encode(asked), tick + since)
        if act.diverged:  # weights of 1000 may lead anywhere
            assert answer is None
            return
        assert answer == codec.encode(act)
        assert quick._minds.models().tobytes() == slow._minds.models().tobytes()


@pytest.mark.parametrize("method", FEDERATED)
@pytest.mark.parametrize("rows", [1, 3])
def test_a_weight_that_cannot_be_uploaded_takes_the_long_way(
    method: Method, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = flown(method, "federation.fraction=1.0")
    coding = payload.upload(of)
    models = np.random.default_rng(3).normal(size=(rows, MODEL_FLOATS))
    largest = float(np.abs(models[:, model.shared(method)]).max())
    for bound, is_short in ((largest, False), (np.nextafter(largest, 9.0), True)):
        monkeypatch.setattr(coding, "largest", bound)
        quick, slow = agent(of, rows, models), agent(of, rows, models)
        asked = sense(5, rows)
        answer = quick.reflex(codec.encode(asked), 5)
        assert (answer is not None) == is_short
        assert (answer or codec.encode(quick.act(asked))) == codec.encode(slow.act(asked))
        assert quick._minds.models().tobytes() == slow._minds.models().tobytes()


@pytest.mark.parametrize("weight", [3.5e38, -1e300])
def test_a_weight_beyond_a_float_comes_to_the_same_as_the_long_way(weight: float) -> None:
    of = flown(Method.MFGFL_HF, "federation.fraction=1.0")
    models = np.zeros((3, MODEL_FLOATS))
    models[1, 7] = weight
    quick, slow = agent(of, 3, models), agent(of, 3, models)
    asked = sense(5)
    assert quick.reflex(codec.encode(asked), 5) is None
    assert quick._minds.models().tobytes() == models.tobytes()
    assert codec.encode(quick.act(asked)) == codec.encode(slow.act(asked))


@pytest.mark.parametrize("method", FEDERATED)
@settings(max_examples=30, deadline=None, database=None)
@given(damage=st.lists(st.tuples(st.integers(0, 109), st.integers(0, 255)), max_size=3), cut=st.integers(-3, 3))
def test_a_damaged_question_in_the_tick_of_an_upload_comes_to_the_same(
    method: Method, damage: list[tuple[int, int]], cut: int
) -> None:
    raw = bytearray(codec.encode(sense(10)))
    for place, byte in damage:
        raw[place % len(raw)] = byte
    comes_to_the_same(flown(method), bytes(raw[:cut] if cut < 0 else raw + b"\xc2" * cut), 10)


def test_an_upload_that_is_not_sent_by_reflex_leaves_no_residual_behind() -> None:
    of = flown(Method.MFGFL_HF, "federation.payload=int8")
    quick, slow = agent(of), agent(of)
    for node in (quick, slow):
        for tick in range(5):
            node.act(sense(tick))
    assert quick.reflex(codec.encode(sense(6)), 5) is None
    asked = sense(5, checkpoint=True)
    assert quick.reflex(codec.encode(asked), 5) is None
    act = slow.act(asked)
    assert act.residuals is not None
    assert act.residuals.any()
    assert codec.encode(quick.act(asked)) == codec.encode(act)


def unlike(frames: Frames, **other: object) -> tuple[Frames, ...]:
    return (msgspec.structs.replace(frames, **other),)


def nearly_brought() -> dict[str, tuple[Frames, ...]]:
    good = brought(flown(), 1, 3)
    wide, none = good.payload.astype(np.float64), good.payload.copy()
    none[0, 7] = np.nan
    infinite, huge, last = good.payload.copy(), good.payload.copy(), good.payload.copy()
    infinite[0, 245], huge[0, 0], last[0, 120] = -np.inf, 3e38, np.inf
    return {
        "twice": (good, good),
        "of another UAV": unlike(good, source=good.source + 1),
        "of a UAV that is not": unlike(good, source=good.source + 100),
        "of another round": unlike(good, round=2),
        "to some of the rows": unlike(good, links=np.array([[0, 0], [0, 2]], np.int32)),
        "in another order": unlike(good, links=np.array([[0, 1], [0, 0], [0, 2]], np.int32)),
        "to other rows": unlike(good, links=np.array([[0, 0], [0, 1], [0, 5]], np.int32)),
        "beyond the payload": unlike(good, links=np.array([[0, 0], [0, 1], [1, 2]], np.int32)),
        "without links": unlike(good, links=None),
        "an upload": unlike(good, kind=FrameKind.UPLOAD),
        "wider floats": unlike(good, payload=wide),
        "fewer floats": unlike(good, payload=good.payload[:, :245]),
        "not a number": unlike(good, payload=none),
        "infinity": unlike(good, payload=infinite),
        "infinity in a density": unlike(good, payload=last),
        "far beyond all bounds": unlike(good, payload=huge),
    }


@pytest.mark.parametrize("what", nearly_brought())
def test_what_is_not_quite_a_global_model_is_not_heard_by_reflex(what: str) -> None:
    node, untouched = agent(flown()), agent(flown())
    assert node.reflex(codec.encode(sense(7, inbox=nearly_brought()[what])), 7) is None
    assert minds(node, 8) == minds(untouched, 8)


@pytest.mark.parametrize("what", nearly_brought())
def test_what_is_not_quite_a_global_model_comes_to_the_same_as_the_long_way(what: str) -> None:
    comes_to_the_same(flown(), codec.encode(sense(7, inbox=nearly_brought()[what])), 7)


def comes_to_the_same(of: Scenario, raw: bytes, tick: int) -> None:
    """Bytes in the tick in which a global model may come: by reflex first, as a spoke does, or the long way alone."""
    quick, slow = agent(of), agent(of)
    for node in (quick, slow):
        for before in range(tick - 2, tick):
            node.act(sense(before))
    told = []
    for node in (quick, slow):
        answer = node.reflex(raw, tick) if node is quick else None
        if answer is None:
            try:
                asked = codec.decode(raw)
                answer = codec.encode(node.act(asked)) if isinstance(asked, Sense) and asked.run == NUMBER else None
            except MessageRejected as error:
                answer = error.reason.encode()
        told.append((answer, minds(node, tick + 1)))
    assert told[0] == told[1]


@pytest.mark.parametrize("broadcast", ["float64", "float32", "int8"])
@pytest.mark.parametrize("method", FEDERATED)
def test_a_damaged_global_model_comes_to_the_same_as_the_long_way(method: Method, broadcast: str) -> None:
    of = flown(method, "radio.bits_per_float=64", f"federation.broadcast_payload={broadcast}")
    good = codec.encode(sense(7, inbox=(brought(of, 1, 3),)))

    @settings(max_examples=30, deadline=None, database=None)
    @given(st.lists(st.tuples(st.integers(0, len(good) - 1), st.integers(0, 255)), min_size=1, max_size=4))
    def check(damage: list[tuple[int, int]]) -> None:
        raw = bytearray(good)
        for place, byte in damage:
            raw[place] = byte
        comes_to_the_same(of, bytes(raw), 7)

    check()
    comes_to_the_same(of, good, 7)
    for other in (good[:-1], good[1:], good + b"\xc2", good[:300], good[:60] + good[61:] + b"\0"):
        comes_to_the_same(of, other, 7)
        node, untouched = agent(of), agent(of)
        assert node.reflex(other, 7) is None
        assert minds(node, 8) == minds(untouched, 8)


def test_a_head_relays_in_a_tick_that_brings_it_nothing() -> None:
    hops = ("radio.coherence_time_s=0.1", "radio.latency_threshold_slots=2")  # two ticks each
    of = flown(Method.MFGFL_HF, "federation.period=10", "federation.clusters=2", *hops)
    quick, slow, relays = agent(of), agent(of), 0
    for tick in range(100):
        number, since = divmod(tick, 10)
        heard = Frames(FrameKind.UPLOAD, number, GLOBAL.source + 1, GLOBAL.payload, GLOBAL.links)
        asked = sense(tick, inbox=(heard,) if number and since == 1 else ())
        act = slow.act(asked)
        relays += any(batch.kind == FrameKind.RELAY for batch in act.outbox)
        raw = codec.encode(asked)
        assert (quick.reflex(raw, tick) or codec.encode(quick.act(asked))) == codec.encode(act)
    assert relays == 9


def test_a_program_has_no_reflex() -> None:
    assert agent(flown(Method.OFFLINE)).reflex(codec.encode(sense(1)), 1) is None


def test_a_reflex_needs_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "_kernel", None)
    assert agent(flown()).reflex(codec.encode(sense(1)), 1) is None


def test_where_states_are_shared_or_uavs_are_paused_no_tick_is_plain() -> None:
    sharing = flown(Method.MFGFL_HF, "federation.state_period=7")
    pause = {"kind": "pause", "uavs": [0], "time_s": 3.0, "duration_s": 1.0}
    for of in (sharing, load(None, ["uavs=8"], faults=[pause])):
        assert agent(of).reflex(codec.encode(sense(1)), 1) is None


NOT_PLAIN = {
    "another run": Sense(NUMBER + 1, 2, states_at(2), False),
    "another tick": sense(3),
    "a checkpoint is wanted": sense(2, report=True, checkpoint=True),
    "a global model has come": sense(2, inbox=(GLOBAL,)),
    "other rows": sense(2, 2),
    "no rows": Sense(NUMBER, 2, np.zeros((0, 4)), False),
    "floats of half the width": Sense(NUMBER, 2, states_at(2, 6).astype(np.float32), False),
    "not a number": Sense(NUMBER, 2, np.full((3, 4), np.nan), False),
    "infinity": Sense(NUMBER, 2, np.full((3, 4), -np.inf), False),
    "a state beyond all bounds": Sense(NUMBER, 2, np.full((3, 4), 1e200), False),
    "an act": Act(NUMBER, 2, np.zeros((3, 5))),
}


@pytest.mark.parametrize("what", NOT_PLAIN)
def test_what_is_not_plain_is_left_to_the_long_way_and_changes_nothing(what: str) -> None:
    node, untouched = agent(flown()), agent(flown())
    for each in (node, untouched):
        assert each.reflex(codec.encode(sense(1)), 1) is not None
    assert node.reflex(codec.encode(NOT_PLAIN[what]), 2) is None
    assert minds(node, 2) == minds(untouched, 2)


@settings(max_examples=150, deadline=None, database=None)
@given(st.binary(max_size=200) | st.tuples(st.integers(0, 62), st.integers(1, 255)))
def test_a_reflex_withstands_any_bytes(hostile: bytes | tuple[int, int]) -> None:
    if isinstance(hostile, tuple):
        good = bytearray(codec.encode(sense(1, 1)))
        good[hostile[0] % len(good)] ^= hostile[1]
        hostile = bytes(good)
    node = agent(flown(), 1)
    answer = node.reflex(hostile, 1)
    if answer is not None:  # then the codec reads the same
        understood = codec.decode(hostile)
        assert isinstance(understood, Sense)
        assert codec.encode(agent(flown(), 1).act(understood)) == answer


def test_once_a_row_is_silenced_there_is_no_reflex_any_more() -> None:
    node, tick = agent(flown(Method.MFG)), 0
    wild = states_at(0)
    wild[1] = [1e8, 1e8, 1e8, 1e8]
    while not node.act(Sense(NUMBER, tick, wild, False)).diverged:
        tick += 1
        assert tick < 50, "it never diverged"
    assert node.reflex(codec.encode(sense(tick + 1)), tick + 1) is None


def test_a_global_model_taken_over_the_long_way_leaves_minds_that_go_on_by_reflex() -> None:
    node = agent(flown())
    node.act(sense(1, inbox=(GLOBAL,)))
    slow = agent(flown())
    slow.act(sense(1, inbox=(GLOBAL,)))
    for tick in (2, 3, 4):
        raw = codec.encode(sense(tick))
        assert node.reflex(raw, tick) == codec.encode(slow.act(sense(tick)))
