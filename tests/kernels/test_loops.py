"""Short loops in C: columns, fading, motion, linear systems, products, the nearest few; both forms against NumPy."""

from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from meanflock.kernels import reference

both_forms = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
seeds = st.integers(0, 2**32 - 1)


@both_forms
@given(st.integers(0, 5), st.integers(0, 4), st.integers(0, 4), st.booleans(), seeds)
def test_columns_of_any_strides_are_side_by_side(
    backend: ModuleType, rows: int, first: int, second: int, turned: bool, seed: int
) -> None:
    whole = np.random.default_rng(seed).normal(0, 1e3, (2 * rows, first + second))[::2]
    whole = np.asfortranarray(whole) if turned else whole
    out = np.full(whole.shape, 7.0)
    right = whole[:, first:] if second or turned else None
    assert backend.columns(whole[:, :first], right, out, first) == np.abs(whole).max(initial=0.0)
    np.testing.assert_array_equal(out, whole)
    assert backend.largest(out) == np.abs(whole).max(initial=0.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [(0, 0), (1, 3), (2, 4)])
def test_the_largest_tells_whether_a_number_is_not_finite(backend, bad: float, where: tuple[int, int]) -> None:
    whole = np.ones((3, 5))
    whole[where] = bad
    whole[2, 2] = 1e300
    for largest in (backend.columns(whole[:, :2], whole[:, 2:], np.empty((3, 5)), 2), backend.largest(whole)):
        assert np.isnan(largest) if np.isnan(bad) else largest == np.inf


@pytest.mark.parametrize(
    ("left", "right", "out"),
    [
        (np.zeros((3, 2)), np.zeros((3, 2)), (3, 5)),
        (np.zeros((2, 2)), np.zeros((2, 3)), (3, 5)),
        (np.zeros((3, 2)), None, (3, 5)),
        (np.zeros((3, 2)), np.zeros((3, 3), np.float32), (3, 5)),
        (np.zeros((3, 2), np.int64), np.zeros((3, 3)), (3, 5)),
    ],
)
def test_tables_that_do_not_fit_are_refused_and_nothing_is_written(
    backend: ModuleType, left: np.ndarray, right: np.ndarray | None, out: tuple[int, int]
) -> None:
    room = np.full(out, 7.0)
    with pytest.raises(ValueError, match="columns"):
        backend.columns(left, right, room, 2)
    assert (room == 7.0).all()


@both_forms
@given(st.integers(1, 40), st.integers(1, 3), st.booleans(), seeds)
def test_a_message_is_sent_link_by_link(backend: ModuleType, links: int, needed: int, alike: bool, seed: int) -> None:
    draw = np.random.default_rng(seed)
    xi, chi = draw.uniform(0, 3), draw.uniform(0.1, 2)
    thresholds = draw.uniform(0, 6, 1 if alike else links)
    busy, missing, slots = np.arange(links), np.full(links, needed), np.full(links, -1)
    expected_busy, expected_missing, expected_slots = list(range(links)), [needed] * links, [-1] * links
    for slot in range(1, 6):
        normal = draw.standard_normal((len(expected_busy), 2))
        for link, (along, across) in zip(expected_busy.copy(), normal.tolist(), strict=True):
            x, y = along * chi + xi, across * chi
            expected_missing[link] -= x * x + y * y >= thresholds[0 if alike else link]
            expected_slots[link] = slot
            if not expected_missing[link]:
                expected_busy.remove(link)
        left = backend.fade(normal, xi, chi, thresholds, slot, busy, missing, slots)
        assert busy[:left].tolist() == expected_busy
        assert missing.tolist() == expected_missing
        assert slots.tolist() == expected_slots


@both_forms
@given(st.integers(1, 40), st.integers(1, 3), seeds)
def test_a_slot_is_good_with_the_probability_of_its_link(
    backend: ModuleType, links: int, needed: int, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    success, expected_busy, expected_missing = draw.random(links), list(range(links)), np.full(links, needed)
    busy, missing, slots = np.arange(links), np.full(links, needed), np.full(links, -1)
    for slot in range(1, 6):
        uniform = draw.random(len(expected_busy))
        expected_missing[expected_busy] -= uniform < success[expected_busy]
        left = backend.send(uniform, success, slot, busy, missing, slots)
        assert (slots[expected_busy] == slot).all()
        expected_busy = [link for link in expected_busy if expected_missing[link]]
        assert busy[:left].tolist() == expected_busy
        np.testing.assert_array_equal(missing, expected_missing)


@both_forms
@given(st.integers(0, 6), st.integers(0, 30), st.booleans(), seeds)
def test_terms_of_poisson_are_summed_from_the_last(backend, rates: int, terms: int, late: bool, seed: int) -> None:
    draw = np.random.default_rng(seed)
    rate, reached = draw.uniform(0, 20, rates), draw.uniform(0, 1, 12)
    first = draw.integers(0, 20, rates).astype(float) * late
    sums = np.full(rates, np.nan)
    backend.poisson(rate, first, terms, reached, sums)
    for row in range(rates):
        expected = 0.0
        for k in range(terms, -1, -1):
            expected *= rate[row] / (first[row] + (k + 1.0))
            expected += reached[min(int(first[row]) + k, 11)]
        assert sums[row] == expected


@both_forms
@given(st.integers(0, 30), st.integers(0, 200), seeds)
def test_waves_are_summed_at_each_place(backend: ModuleType, places: int, waves: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    place, vectors, phase = draw.normal(0, 50, (places, 2)), draw.standard_cauchy((2, waves)), draw.random(waves)
    sums, defined = np.full(places, 7.0), np.full(places, 7.0)
    backend.waves(place, vectors, phase, sums)
    exact = np.cos(2 * np.pi * np.remainder(place @ vectors + phase, 1.0)).sum(axis=-1)
    size = np.abs(place).sum(axis=-1, initial=1.0) * np.abs(vectors).max(initial=1.0) * (1 + waves)
    assert (np.abs(sums - exact) <= 1e-11 * (1 + waves) + 1e-14 * size).all()
    reference.waves(place, vectors, phase, defined)
    np.testing.assert_array_equal(sums, defined)


@both_forms
@given(st.integers(1, 3), st.integers(1, 4), st.integers(2, 9), st.integers(0, 30), seeds)
def test_a_number_is_between_those_of_the_columns_around_it(
    backend: ModuleType, count: int, rows: int, columns: int, links: int, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    tables, row = draw.normal(size=(count, rows, columns)), draw.integers(0, rows, links)
    place = draw.uniform(-2, columns + 1, links)
    place[::3] = np.rint(place[::3])
    place[4::7] = np.nan  # counts as the first column
    found, defined = np.full((count, links), 7.0), np.full((count, links), 7.0)
    backend.interpolate(tables, row, place, found)
    for table, numbers in zip(tables, found, strict=True):
        expected = [np.interp(at, np.arange(columns), table[one]) for at, one in zip(place, row, strict=True)]
        expected = [table[one, 0] if at != at else each for at, one, each in zip(place, row, expected, strict=True)]
        assert numbers == pytest.approx(expected, rel=1e-12, abs=1e-12)
    reference.interpolate(tables, row, place, defined)
    np.testing.assert_array_equal(found, defined)


@both_forms
@given(st.integers(0, 20), st.sampled_from([2, 3]), st.booleans(), seeds)
def test_a_point_mass_is_pushed_dragged_and_shaken(
    backend: ModuleType, uavs: int, axes: int, alike: bool, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    states, (push, noise) = draw.normal(0, 9, (uavs, 2 * axes)), draw.normal(0, 2, (2, uavs, axes))
    wind = draw.normal(0, 2, axes if alike else (uavs, axes))
    drag, shake, dt = draw.uniform(0, 1, 3)
    moved = np.full((uavs, 2 * axes), np.nan)
    backend.move(states, push, noise, wind, drag, shake, dt, moved)
    before, velocity = states[:, axes:], moved[:, axes:]
    np.testing.assert_array_equal(velocity, (before + (push - (before - wind) * drag) * dt) + shake * noise)
    np.testing.assert_array_equal(moved[:, :axes], velocity * dt + states[:, :axes])


@both_forms
@given(st.integers(0, 30), st.sampled_from([2, 3]), seeds)
def test_those_within_the_radius_that_were_asked_for_are_counted(
    backend: ModuleType, uavs: int, axes: int, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    states, goals = draw.normal(0, 1, (2, uavs, 2 * axes))
    asked = draw.random(uavs) < 0.7
    off = states - goals
    distances = np.sqrt(np.add.reduce(off * off, axis=1))
    radius = float(np.median(distances)) if uavs % 2 else 2.0  # one UAV is exactly there
    within = asked.copy()
    count = backend.reached(states, goals, radius, within)
    np.testing.assert_array_equal(within, asked & (distances <= radius))
    assert count == within.sum()


@both_forms
@given(st.integers(0, 4), st.integers(1, 9), st.integers(1, 5), seeds)
def test_systems_are_solved_one_by_one(backend: ModuleType, systems: int, size: int, sides: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    matrices, rights = draw.normal(size=(systems, size, size)), draw.normal(size=(systems, size, sides))
    matrices[::2, 0, 0] = 0.0  # the first pivot is another row
    found, defined = np.empty_like(rights), np.empty_like(rights)
    backend.solve(matrices, rights, found)
    reference.solve(matrices, rights, defined)
    np.testing.assert_array_equal(found, defined)
    regular = np.abs(np.linalg.det(matrices)) > 1e-3
    np.testing.assert_allclose(matrices[regular] @ found[regular], rights[regular], atol=1e-6)
    if systems:
        alone = np.empty_like(rights[:1])
        backend.solve(matrices[-1:].copy(), rights[-1:].copy(), alone)
        np.testing.assert_array_equal(alone, found[-1:])


@pytest.mark.parametrize("entry", [0.0, np.nan, np.inf])
def test_a_singular_system_has_no_finite_solution(backend: ModuleType, entry: float) -> None:
    matrices = np.stack([np.eye(3), np.eye(3)])
    matrices[1, 1, 1] = entry
    found = np.empty((2, 3, 1))
    backend.solve(matrices, np.ones((2, 3, 1)), found)
    np.testing.assert_array_equal(found[0], 1.0)
    assert entry == np.inf or not np.isfinite(found[1]).all()


@both_forms
@given(st.sampled_from([(3, 3), (1, 3), (3, 1), (1, 1)]), st.tuples(*[st.integers(1, 7)] * 3), seeds)
def test_products_are_sums_in_the_order_of_their_terms(
    backend: ModuleType, systems: tuple[int, int], sizes: tuple[int, int, int], seed: int
) -> None:
    draw, (n, m, k) = np.random.default_rng(seed), sizes
    left, right = draw.normal(size=(systems[0], n, m)), draw.normal(size=(systems[1], m, k))
    found = np.empty((max(systems), n, k))
    backend.multiply(left, right, found)
    terms = left[:, :, :, None] * right[:, None]
    total = terms[:, :, 0]
    for term in range(1, m):
        total = total + terms[:, :, term]
    np.testing.assert_array_equal(found, total)


@both_forms
@given(st.integers(0, 4), st.integers(0, 12), st.integers(0, 6), st.sampled_from([4.0, np.inf]), seeds)
def test_the_nearest_few_come_first_and_ties_in_their_order(
    backend: ModuleType, rows: int, objects: int, most: int, reach: float, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    distance = draw.integers(0, 6, size=(rows, objects)).astype(float)
    for unlike in (np.nan, np.inf):
        distance[draw.random(distance.shape) < 0.1] = unlike
    found = np.full((rows, most), 7, dtype=np.intp)
    largest = backend.closest(distance, reach, found)
    for row, numbers in zip(distance, found, strict=True):
        expected = sorted((apart, number) for number, apart in enumerate(row) if apart <= reach)[:most]
        assert numbers.tolist() == [number for _, number in expected] + [-1] * (most - len(expected))
    assert largest == (found >= 0).sum(axis=1).max(initial=0)


@both_forms
@given(
    st.integers(0, 4),
    st.integers(1, 9),
    st.integers(0, 6),
    st.sampled_from([2, 3]),
    st.sampled_from([4.0, np.inf]),
    seeds,
)
def test_neighbours_are_the_nearest_other_uavs_as_each_row_knows_them(
    backend: ModuleType, rows: int, uavs: int, most: int, axes: int, reach: float, seed: int
) -> None:
    """On a grid many are equally far, and some at one place; the state of some is unknown or not finite."""
    draw = np.random.default_rng(seed)
    own = draw.integers(0, 3, size=(rows, 2 * axes)).astype(float)
    others = draw.integers(0, 3, size=(rows, 2 * axes, uavs)).astype(float)
    for unlike in (np.nan, np.inf):
        others[draw.random(others.shape) < 0.05] = unlike
    numbers = draw.integers(0, uavs, size=rows)
    away, closing = np.full((rows, most, axes), 7.0), np.full((rows, most, axes), 7.0)
    squared, found = np.full((rows, most), 7.0), np.full((rows, most), 7, dtype=np.intp)
    largest = backend.neighbours(own, others, numbers, reach, away, closing, squared, found)
    assert largest == (found >= 0).sum(axis=1).max(initial=0)
    for m, uav in enumerate(numbers.tolist()):
        apart = own[m] - others[m].T
        lengths = (apart[:, :axes] ** 2).sum(axis=1)
        near = sorted((lengths[j], j) for j in range(uavs) if j != uav and lengths[j] <= reach)[:most]
        assert found[m].tolist() == [j for _, j in near] + [-1] * (most - len(near))
        for place, (length, j) in enumerate(near):
            moved_apart = np.array([-1e-3 if uav < j else 1e-3, 0.0, 0.0][:axes])
            np.testing.assert_array_equal(away[m, place], apart[j, :axes] if length else moved_apart)
            np.testing.assert_array_equal(closing[m, place], apart[j, axes:])
            assert squared[m, place] == (length or 1e-3 * 1e-3)


@both_forms
@given(st.integers(0, 6), st.integers(0, 12), st.booleans(), seeds)
def test_picked_links_use_frames_that_are_numbered_anew(
    backend: ModuleType, frames: int, count: int, all_are: bool, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    links = draw.integers(0, [max(frames, 1), 9], size=(count if frames else 0, 2)).astype(np.int32)
    chosen = draw.random(len(links)) < 0.5
    picked, used = np.full_like(links, 7), np.full(frames, 7, dtype=np.intp)
    kept, rows = backend.pick(links, None if all_are else chosen, picked, used)
    expected = [link for link, is_in in zip(links.tolist(), chosen.tolist(), strict=True) if is_in or all_are]
    old = sorted({frame for frame, _ in expected})
    assert (kept, used[:rows].tolist()) == (len(expected), old)
    assert picked[:kept].tolist() == [[old.index(frame), uav] for frame, uav in expected]
