"""The compiled tick gives the bits of NumPy's, whatever the numbers; and what does not fit it is refused."""

import shutil
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agent import kernel
from agent.learner import Learner
from agent.minds import Minds, Outcome
from groundstation.engine import Engine
from swarm import plain, state
from swarm.methods import Method
from swarm.scenario import Scenario, load
from worldsim.formation import initial_states

LEARNING = [method for method in Method if method.learns_value]

LANES = 8  # as many rows as any machine steps at once, or more

needs_kernel = pytest.mark.skipif(not kernel.is_compiled(), reason="installed without a C compiler")


def scenario(method: Method, *changes: str) -> Scenario:
    return load(None, ["uavs=9", *changes], method=str(method))


def tick_both_ways(flown: Scenario, minds: Minds, states: np.ndarray, known: np.ndarray | None) -> list[bytes]:
    """The bits of a tick by the kernel and by NumPy, and what the minds were afterwards."""
    results = []
    for compiled in (True, False):
        with np.errstate(all="ignore"):
            outcome = Learner(flown, compiled=compiled).step(minds, states, known)
        # A NaN is a NaN: its sign and payload mean nothing.
        whole = np.concatenate([outcome.minds.models().ravel(), outcome.numbers.ravel()])
        results.append(np.where(np.isnan(whole), np.nan, whole).tobytes())
    return results


def test_where_there_is_a_compiler_there_is_a_kernel() -> None:
    headers = Path(sysconfig.get_path("include"), "Python.h")
    assert kernel.is_compiled() or shutil.which("cc") is None or not headers.exists()


@needs_kernel
@pytest.mark.parametrize("method", LEARNING)
@pytest.mark.parametrize("rows", [*range(1, 2 * LANES + 2), 25, 130])
def test_a_flight_of_the_kernel_is_that_of_numpy(method: Method, rows: int) -> None:
    flown, draw = scenario(method), np.random.default_rng(rows)
    states = draw.uniform([-50, -50, -8, -8], [180, 130, 8, 8], (rows, state.SIZE))
    states[0] = 0.0  # r = 0, where the local cost is undefined
    known = None if method.learns_density else draw.normal(0, 30, (rows, 300, state.SIZE))
    minds = Learner(flown).init(rows, initial_states(flown))
    for _ in range(20):
        compiled, plain = tick_both_ways(flown, minds, states, known)
        assert compiled == plain
        outcome = Learner(flown).step(minds, states, known)
        minds = outcome.minds
        states = states + 0.1 * np.concatenate([states[:, state.VELOCITY], outcome.accelerations], axis=-1)


numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)


@needs_kernel
@settings(max_examples=60, deadline=None)
@given(
    arrays(np.float64, (3, 2, 54), elements=numbers),
    arrays(np.float64, (3, 2, 69), elements=numbers),
    arrays(np.float64, (3, 4), elements=numbers),
    arrays(np.float64, (3, 9, 4), elements=numbers),
)
def test_numbers_beyond_all_bounds_are_treated_alike(
    value: np.ndarray, density: np.ndarray, states: np.ndarray, known: np.ndarray
) -> None:
    for method in (Method.MFG, Method.HJB):
        compiled, plain = tick_both_ways(
            scenario(method), Minds(value, density), states, None if method.learns_density else known
        )
        assert compiled == plain


def flying(method: Method, rows: int) -> tuple[Learner, Minds, np.ndarray, np.ndarray | None]:
    """A learner, and rows as different as those of a swarm on its way."""
    learner, draw = Learner(scenario(method)), np.random.default_rng(rows)
    minds = learner.init(rows, initial_states(scenario(method)))
    minds = Minds(draw.normal(0, 0.1, minds.value.shape), minds.density + draw.normal(0, 0.1, minds.density.shape))
    states = draw.uniform([-50, -50, -8, -8], [180, 130, 8, 8], (rows, state.SIZE))
    return learner, minds, states, None if method.learns_density else draw.normal(0, 30, (rows, 9, state.SIZE))


def rows_of(outcome: Outcome) -> list[bytes]:
    """The bits of each row: its models and its numbers."""
    return [
        models.tobytes() + row.tobytes() for models, row in zip(outcome.minds.models(), outcome.numbers, strict=True)
    ]


@needs_kernel
@pytest.mark.parametrize("method", [Method.MFG, Method.HJB])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
@pytest.mark.parametrize("rows", [LANES, LANES + 3])
def test_a_row_never_touches_another(method: Method, bad: float, rows: int) -> None:
    learner, minds, states, known = flying(method, rows)
    sound = rows_of(learner.step(minds, states, known))
    for broken in range(rows):
        for where in (states, minds.value, minds.density):
            kept = where[broken].copy()
            where[broken] = bad
            others = rows_of(learner.step(minds, states, known))
            where[broken] = kept
            assert others[:broken] + others[broken + 1 :] == sound[:broken] + sound[broken + 1 :]


@needs_kernel
@pytest.mark.parametrize("method", [Method.MFG, Method.HJB])
@pytest.mark.parametrize("rows", range(1, 2 * LANES + 2))
def test_a_row_is_the_same_in_any_company_and_nothing_is_read_or_written_beyond_the_last(
    method: Method, rows: int
) -> None:
    """The arrays given are the beginnings of longer ones, which hold what would show."""
    learner, minds, states, known = flying(method, 2 * LANES + 2)
    alone = [
        rows_of(
            learner.step(
                Minds(minds.value[row], minds.density[row]), states[row], None if known is None else known[row]
            )
        )[0]
        for row in (slice(k, k + 1) for k in range(rows))
    ]
    for array in (states, minds.value, minds.density, *([] if known is None else [known])):
        array[rows:] = np.nan
    given = (states[:rows], minds.value[:rows], minds.density[:rows], None if known is None else known[:rows])
    value, density, numbers = (np.full((2 * LANES + 2, *shape), 7.0) for shape in ((2, 54), (2, 69), (5,)))
    if known is not None:
        density[:rows] = minds.density[:rows]  # nothing learns it
    assert learner.kernel is not None
    kernel._kernel.step(learner.kernel._tables, *given, value[:rows], density[:rows], numbers[:rows])
    stepped = Outcome(Minds(value[:rows], density[:rows]), numbers[:rows], 0.0)
    assert rows_of(stepped) == alone
    assert all((array[rows:] == 7.0).all() for array in (value, density, numbers))


@needs_kernel
@pytest.mark.parametrize("method", [Method.MFGFL_HF, Method.HJB])
def test_whole_flights_end_in_the_same_hash(method: Method, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = scenario(method, "duration=30")
    hashes = []
    for _ in range(2):
        engine = Engine(flown, "kernel-test")
        for _ in engine.fly():
            pass
        hashes.append(engine.world.finish()["trajectory_sha256"])
        monkeypatch.setattr(kernel, "_kernel", None)
    assert hashes[0] == hashes[1]


@needs_kernel
def test_an_exponent_other_than_one_is_left_to_numpy() -> None:
    assert kernel.Kernel.serves(scenario(Method.HJB))
    assert not kernel.Kernel.serves(scenario(Method.HJB, "cost.beta=0.5"))
    assert kernel.Kernel.serves(scenario(Method.MFG, "cost.beta=0.5"))


@needs_kernel
def test_what_does_not_fit_is_refused_before_anything_is_written() -> None:
    learner = Learner(scenario(Method.MFG))
    minds = learner.init(2, initial_states(scenario(Method.MFG)))
    tables = learner.kernel._tables  # type: ignore[union-attr]
    good = [np.zeros((2, 4)), minds.value, minds.density, None]
    out = [np.full((2, 2, 54), 7.0), np.full((2, 2, 69), 7.0), np.full((2, 5), 7.0)]
    for place, wrong in [
        (0, np.zeros((3, 4))),
        (1, minds.value[:1]),
        (2, minds.density.astype(np.float32)),
        (2, minds.density[:, :, ::2]),
        (3, np.zeros((2, 9, 3))),
    ]:
        arguments = [*good[:place], wrong, *good[place + 1 :], *out]
        with pytest.raises((ValueError, BufferError), match=r"expected|contiguous"):
            kernel._kernel.step(tables, *arguments)
    with pytest.raises(ValueError, match="PyCapsule"):
        kernel._kernel.step(object(), *good, *out)
    assert all((array == 7.0).all() for array in out)


def sides(rows: int = 2) -> Any:
    """Zeros, and as much room."""
    arrays = [np.zeros((rows, 2, count)) for count in (54, 69) * 2]
    return kernel._kernel.Sides(Learner(scenario(Method.MFG)).kernel._tables, 1e6, *arrays)  # type: ignore[union-attr]


@needs_kernel
def test_sides_of_what_does_not_fit_are_refused() -> None:
    learner = Learner(scenario(Method.MFG))
    minds, after = (learner.init(2, initial_states(scenario(Method.MFG))) for _ in range(2))
    tables = learner.kernel._tables  # type: ignore[union-attr]
    good = [tables, 1e6, minds.value, minds.density, after.value, after.density]
    assert kernel._kernel.Sides(*good).side == 0
    fixed = after.density.copy()
    fixed.flags.writeable = False
    hjb = Learner(scenario(Method.HJB)).kernel._tables  # type: ignore[union-attr]
    for place, wrong in [
        (0, object()),
        (0, hjb),
        (1, "high"),
        (2, minds.value[:0]),
        (3, minds.density[:1]),
        (4, after.value.astype(np.float32)),
        (5, np.zeros((2, 4, 69))[:, ::2]),
        (5, fixed),
    ]:
        with pytest.raises((TypeError, ValueError, BufferError)):
            kernel._kernel.Sides(*good[:place], wrong, *good[place + 1 :])
    with pytest.raises(TypeError):
        kernel._kernel.Sides(*good, last=1)
    with pytest.raises(AttributeError):
        kernel._kernel.Sides(*good).side = 1
    with pytest.raises(TypeError):
        kernel._kernel.Turn(object(), ())


ASKED = (b"a", plain.TICK, b"b", kernel.STATES, b"c")
SAID = (b"d", plain.TICK, b"e", kernel.OUTCOME, b"f")
HEARD = (*ASKED, plain.NUMBER, b"g", kernel.MODELS, b"h")
SENT = (*SAID, plain.NUMBER, b"g", kernel.SOURCE, b"h", kernel.MODELS, b"i", kernel.REPORT, b"j")
CODING = (0, 246, 4, 1e30)
NAMES = np.array([3, 5], "<i4").tobytes()


@needs_kernel
@pytest.mark.parametrize(
    "kinds",
    [
        [(ASKED, SAID)],
        (ASKED, SAID),
        ((ASKED,),),
        ((ASKED, SAID, SAID),),
        ([ASKED, SAID],),
        (([*ASKED], SAID),),
        ((ASKED, None),),
        ((ASKED, ()),),
        ((ASKED[:4], SAID),),
        (((*ASKED[:4], "c"), SAID),),
        (((b"a", b"b", b"c"), SAID),),
        (((b"a", 2.0, b"c"), SAID),),
        (((b"a", 2**70, b"c"), SAID),),
        ((ASKED, (*SAID, 7, b"")),),
        ((ASKED, (*SAID, -1, b"")),),
        ((ASKED, (*SAID, *(0, b"") * 8)),),
        ((ASKED, SAID[:3]),),
        ((ASKED[:3], SAID),),
        ((ASKED, (*SAID, kernel.OUTCOME, b"")),),
        (((*ASKED, kernel.STATES, b""), SAID),),
        ((ASKED, (b"", kernel.REPORT, *SAID)),),
        (((*ASKED, kernel.REPORT, b""), SAID),),
        ((ASKED, (*SAID, kernel.STATES, b"")),),
        ((HEARD, SAID),),  # but how a model travels is not said
        ((ASKED, SENT),),
    ],
)
def test_kinds_that_make_no_sense_are_refused(kinds: Any) -> None:
    with pytest.raises((TypeError, ValueError, OverflowError)):
        kernel._kernel.Turn(sides(), kinds)


@needs_kernel
@pytest.mark.parametrize(
    "models",
    [
        (3, CODING, NAMES),
        (-1, CODING, NAMES),
        (0, CODING, NAMES),
        ("1", CODING, NAMES),
        (1, (1, 246, 4, 1e30), NAMES),
        (1, (0, 247, 4, 1e30), NAMES),
        (1, (108, 108, 4, 1e30), NAMES),
        (1, (246, 0, 4, 1e30), NAMES),
        (1, (-108, 108, 4, 1e30), NAMES),
        (1, (0, 246, 2, 1e30), NAMES),
        (1, (0, 246, 0, 1e30), NAMES),
        (1, (0, 246, 2**62, 1e30), NAMES),
        (1, (0, 246, 4), NAMES),
        (1, CODING, NAMES[:-1]),
        (1, CODING, "names"),
        (1, CODING, b""),
        (1, CODING),
    ],
)
def test_models_that_cannot_travel_are_refused(models: tuple[Any, ...]) -> None:
    with pytest.raises((TypeError, ValueError, OverflowError)):
        kernel._kernel.Turn(sides(), ((ASKED, SENT),), *models)


@needs_kernel
def test_models_of_several_rows_are_not_brought_at_once() -> None:
    with pytest.raises(ValueError, match="gap"):
        kernel._kernel.Turn(sides(), ((HEARD, SAID),), 2, CODING)
    with pytest.raises(TypeError):
        kernel._kernel.Turn(sides(), ((HEARD, SAID),), 1, CODING, NAMES, last=1)


@needs_kernel
def test_a_turn_is_asked_with_what_it_takes_or_refuses() -> None:
    turn = kernel._kernel.Turn(sides(), ((ASKED, SENT),), 1, CODING, NAMES)
    here = np.array([1], np.intp).tobytes()
    assert turn.answer(b"none of these", 1, 2, here) is None
    for wrong in [
        (b"",),
        (b"", 1, 2, here, 0),
        ("", 1, 2, here),
        (bytearray(), 1, 2, here),
        (b"", -1, 2, here),
        (b"", 2**64, 2, here),
        (b"", 1.0, 2, here),
        (b"", 1, -1, here),
        (b"", 1, "2", here),
        (b"", 1, 2),
        (b"", 1, 2, b""),
        (b"", 1, 2, here * 2),
        (b"", 1, 2, here[:-1]),
        (b"", 1, 2, [1]),
        (b"", 1, 2, np.array([2], np.intp).tobytes()),
        (b"", 1, 2, np.array([-1], np.intp).tobytes()),
    ]:
        with pytest.raises((TypeError, ValueError, OverflowError)):
            turn.answer(*wrong)
    with pytest.raises(ValueError, match="places"):
        kernel._kernel.Turn(sides(), ((ASKED, SAID),)).answer(b"", 1, 2, here)
    assert kernel._kernel.Turn(sides(), ()).answer(b"", 1) is None


@needs_kernel
def test_a_template_is_filled_in_its_order_and_nothing_else_is_told_by_it() -> None:
    both, states = sides(), np.arange(8.0)
    turn = kernel._kernel.Turn(both, ((ASKED, SENT), (HEARD, SENT)), 1, CODING, NAMES)
    place = np.array([1], np.intp).tobytes()
    asked = b"a\x07b" + states.tobytes() + b"c"
    model = np.linspace(-1, 1, 246, dtype=np.float32)
    for raw, sent in ((asked, np.zeros(246, np.float32)), (asked + b"\xcd\x01\x2cg" + model.tobytes() + b"h", model)):
        side = both.side
        answer = turn.answer(raw, 7, 300, place)
        assert both.side == 1 - side
        assert answer is not None
        head, tail = b"d\x07e", b"f\xcd\x01\x2cg" + NAMES[4:] + b"h" + sent.tobytes() + b"i"
        assert answer.startswith(head)
        assert answer[len(head) + 80 :].startswith(tail)
        assert answer.endswith(b"j")
        assert len(answer) == len(head) + 80 + len(tail) + 2 * 246 * 8 + 1
        both = sides()
        turn = kernel._kernel.Turn(both, ((ASKED, SENT), (HEARD, SENT)), 1, CODING, NAMES)
        for other in (raw[:-1], raw[1:], raw + b"h", raw[:-1] + b"i", b"b" + raw[1:], raw[:2] + raw[3:], b""):
            assert turn.answer(other, 7, 300, place) is None
        assert turn.answer(raw, 8, 300, place) is None
        if raw != asked:
            assert turn.answer(raw, 7, 301, place) is None
            assert turn.answer(raw, 7, 30, place) is None
        assert both.side == 0


@needs_kernel
def test_tables_that_point_outside_are_refused() -> None:
    learner = Learner(scenario(Method.MFG))
    made: dict[str, np.ndarray] = {}

    def keep(arrays: dict[str, np.ndarray]) -> object:
        made.update(arrays)
        return None

    real = kernel._kernel
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernel, "_kernel", type("Fake", (), {"tables": staticmethod(keep)}))
        kernel.Kernel(learner._scenario, learner._hjb, learner._fpk, learner._quadrature)
    real.tables(made)
    for name in ("weight", "starts", "left", "value_first"):
        for bad in (-1, 10_000):
            broken = {**made, name: made[name].copy()}
            broken[name][-1] = bad
            with pytest.raises(ValueError, match="outside"):
                real.tables(broken)
    last = made["starts"][-1]  # one product for every term but the first, which has all the others
    starts = np.concatenate([[0], np.arange(last - len(made["starts"]) + 2, last + 1)]).astype(np.int32)
    crowded = {**made, "starts": starts}
    with pytest.raises(ValueError, match="outside"):
        real.tables(crowded)
    with pytest.raises(KeyError):
        real.tables({})
