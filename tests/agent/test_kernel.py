"""The compiled tick gives the bits of NumPy's, whatever the numbers; and what does not fit it is refused."""

import shutil
import sysconfig
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from agent import kernel
from agent.learner import Learner
from agent.minds import Minds, Outcome
from groundstation.engine import Engine
from swarm import state
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
