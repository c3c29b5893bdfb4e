"""The mean difference of velocities: both forms against a sum over all pairs in double precision."""

import math
from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from meanflock.kernels import mesh, reference
from meanflock.kernels.differences import ALIGNMENT_ERROR, FEW, MANY
from meanflock.swarm import state

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


def exact(velocities: np.ndarray) -> float:
    total = 0.0
    for i, velocity in enumerate(velocities):
        apart = velocities[i + 1 :] - velocity
        total += float(np.hypot(apart[:, 0], apart[:, 1]).sum())
    return 2.0 * total / len(velocities) ** 2


def flown(velocities: np.ndarray) -> np.ndarray:
    states = np.zeros((len(velocities), state.SIZE))
    states[:, state.VELOCITY] = velocities
    return states


@both_forms
@given(st.integers(1, FEW), st.integers(0, 2**32 - 1))
def test_few_uavs_are_one_sum_in_double_precision(backend: ModuleType, uavs: int, seed: int) -> None:
    velocities = np.random.default_rng(seed).choice([0.0, 0.1, -0.3, 1.0, 1e-160, 1e6 + 0.25], (uavs, state.AXES))
    apart = velocities[:, None] - velocities
    speeds = np.sqrt(apart[..., 0] ** 2 + apart[..., 1] ** 2)
    assert backend.alignment(flown(velocities)) == speeds.ravel().sum() / uavs**2


@st.composite
def swarms(draw: st.DrawFn) -> np.ndarray:
    """Velocities of more than FEW UAVs: clusters of any widths, on a line or not, some UAVs far away, some alike."""
    uavs = draw(st.sampled_from([FEW + 1, 800, MANY + 1, MANY + 500]))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    clusters = draw(st.integers(1, 5))
    widths = np.array(
        draw(st.lists(st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 1.0]), min_size=clusters, max_size=clusters))
    )
    cluster = random.integers(clusters, size=uavs)
    velocities = random.normal(size=(clusters, 2))[cluster] + widths[cluster, None] * random.normal(size=(uavs, 2))
    far = random.integers(uavs, size=draw(st.sampled_from([0, 1, 7, uavs // 4])))
    velocities[far] *= draw(st.sampled_from([30.0, 1e4, 1e9]))
    velocities[:, 1] *= draw(st.sampled_from([0.0, 1e-6, 1.0]))
    if draw(st.booleans()):
        velocities = np.round(velocities, 1)  # many alike, and on the borders of cells
    angle = draw(st.sampled_from([0.0, 0.7]))
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return velocities @ turn * draw(st.sampled_from([1e-9, 1.0, 1e6])) + draw(st.sampled_from([0.0, 12.0]))


@settings(both_forms, max_examples=60)
@given(swarms())
def test_the_error_is_bounded_for_any_velocities(backend: ModuleType, velocities: np.ndarray) -> None:
    """Of velocities far from zero, the differences themselves are known to 2⁻⁵² of the velocities only."""
    expected = exact(velocities)
    rounding = 2.0**-50 * float(np.abs(velocities).max())
    assert backend.alignment(flown(velocities)) == pytest.approx(expected, rel=ALIGNMENT_ERROR, abs=rounding)


@settings(deadline=None, max_examples=40)
@given(swarms())
def test_both_forms_give_the_same_bits(velocities: np.ndarray) -> None:
    compiled = pytest.importorskip("meanflock.kernels.compiled")
    assert compiled.alignment(flown(velocities)) == reference.alignment(flown(velocities))


@pytest.mark.parametrize("uavs", [0, 1, FEW + 1, MANY + 1])
def test_equal_velocities_have_no_difference(backend: ModuleType, uavs: int) -> None:
    assert backend.alignment(flown(np.full((uavs, state.AXES), 0.5))) == 0.0


@pytest.mark.parametrize("uavs", [2, FEW + 1, MANY + 1])
@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e200])
def test_a_velocity_beyond_all_bounds_gives_no_finite_number(backend: ModuleType, uavs: int, bad: float) -> None:
    velocities = np.random.default_rng(1).normal(size=(uavs, state.AXES))
    velocities[1, 0] = bad
    with np.errstate(all="ignore"):
        assert not math.isfinite(backend.alignment(flown(velocities)))


def test_the_bound_is_that_of_the_interpolation() -> None:
    """The bound that mesh.py and differences.py derive, from the functions themselves."""
    part = np.linspace(0.0, 1.0, 501)
    weights = mesh._weights(part)
    nodes = np.arange(-3, 5)
    for power in range(8):  # a polynomial of degree 7 is interpolated exactly
        np.testing.assert_allclose((weights * nodes**power).sum(axis=-1), part**power, atol=1e-12)
    remainder = np.abs(np.prod(part[:, None] - nodes, axis=-1)).max() / math.factorial(8)
    amplification = np.abs(weights).sum(axis=-1).max()
    taylor = Polynomial(mesh._TAYLOR[::-1])(Polynomial([-1.0, 1.0]))
    steepest = 0.0  # |∂⁸L/∂x⁸|, R = 1; beyond R it is that of ‖(x, y)‖, largest on the circle: 1575
    for y in np.linspace(0.0, 1.0, 201):
        along = taylor(Polynomial([y * y, 0.0, 1.0])).deriv(8)
        steepest = max(steepest, np.abs(along(np.linspace(0.0, math.sqrt(1.0 - y * y), 201))).max())
    assert steepest == pytest.approx(135135.0)
    smooth = remainder * steepest / mesh.RADIUS**7 * (1 + amplification + amplification**2 + amplification**3)
    near = mesh.RADIUS * (1.5 * 2.0**-20 + 6 * 2.0**-24)
    assert (smooth + near) * 3.0 / mesh.EXTENT + 2 * 2.0**-24 < ALIGNMENT_ERROR


def test_pairs_beyond_the_reach_of_cells_are_not_near() -> None:
    rows, unit = np.arange(6), mesh.RADIUS / 2  # cells of two spacings
    gap = np.hypot(np.array(mesh._REACH), np.maximum(rows - 1, 0))  # to the first column that is left out
    least = np.append(gap, 5.0) / unit
    np.testing.assert_array_less((mesh._taylor(least**2) - least) * mesh._UNIT, 1.5)
