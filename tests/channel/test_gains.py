"""Laws of fading and their curves, beside SciPy, check values of other codes, and draws."""

import math

import numpy as np
import pytest
from scipy import special, stats

from meanflock.channel import link, rates
from meanflock.channel.curves import MARGINS_DB, Curves
from meanflock.channel.gains import RAYLEIGH, STEADY, Gain, nakagami, rice, rice_by_elevation
from meanflock.channel.tails import gamma_above, normal_below

LAWS = {
    "none": STEADY,
    "rayleigh": RAYLEIGH,
    "rice-3": rice(3.0),
    "rice-15": rice(15.0),
    "nakagami-0.5": nakagami(0.5),
    "nakagami-2": nakagami(2.0),
    "nakagami-4": nakagami(4.0),
}
every = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)

SUCCESS = {  # threshold 5 dB, mean SNR 0, 5, 10, 15, 20 dB
    "rayleigh": (0.042329, 0.367879, 0.728893, 0.904837, 0.968872),
    "rice-3": (0.01439132, 0.414638, 0.82801536, 0.95379301, 0.98653239),
    "rice-15": (0.0, 0.47519455, 0.99976113, 0.99999998, 1.0),
    "nakagami-0.5": (0.075358, 0.317311, 0.573883, 0.75183, 0.858858),
    "nakagami-2": (0.013124, 0.406006, 0.8673, 0.982477, 0.998082),
    "nakagami-4": (0.001384, 0.43347, 0.960326, 0.999224, 0.99999),
    "none": (0.0, 1.0, 1.0, 1.0, 1.0),
}


@pytest.mark.parametrize("name", SUCCESS)
def test_the_success_of_a_slot(name: str) -> None:
    least = 10.0 ** (np.array([0.5, 0.0, -0.5, -1.0, -1.5]))
    assert LAWS[name].success(least) == pytest.approx(SUCCESS[name], abs=1e-6)


def test_the_incomplete_gamma_function_is_scipy_s() -> None:
    x = np.concatenate([[0.0], np.logspace(-6, 3, 400)])
    for shape in (0.5, 0.7, 1.0, 1.5, 2.0, 4.2, 10.0, 50.0):
        np.testing.assert_allclose(gamma_above(shape, x), special.gammaincc(shape, x), rtol=0, atol=5e-14)


def test_the_normal_law_is_scipy_s() -> None:
    z = np.linspace(-8, 8, 33)
    np.testing.assert_allclose(normal_below(z), stats.norm.cdf(z), rtol=1e-12)


@every
def test_a_gain_has_mean_1_and_draws_have_its_law(law: Gain) -> None:
    least = np.concatenate([np.linspace(0, 40, 40_001)])
    assert np.trapezoid(law.success(least), least) == pytest.approx(1.0, abs=2e-3)
    margin_db, links = -10 * math.log10(0.8), 40_000
    success, *_ = Curves([RAYLEIGH, law], 1).chances(1, np.ones(links, dtype=np.intp), np.full(links, margin_db))
    _, good = link.drawn(1, 1, success, np.random.default_rng(3))
    share = float(law.success(np.array([0.8]))[0])
    assert good.mean() == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / links) + 1e-12)


def test_links_of_several_laws_draw_together() -> None:
    laws = list(LAWS.values())
    law = np.arange(len(laws)).repeat(30_000)
    success, *_ = Curves(laws, 4).chances(2, law, np.full(len(law), -10 * math.log10(0.6)))
    slots, good = link.drawn(2, 4, success, np.random.default_rng(4))
    for index, one in enumerate(laws):
        success = one.success(np.array([0.6]))
        lost, spent = link.lost(2, 4, success)[0], link.delivered_slots(2, 4, success)[0]
        assert 1 - good[law == index].mean() == pytest.approx(
            lost, abs=4 * math.sqrt(lost * (1 - lost) / 30_000) + 1e-12
        )
        assert (slots * good)[law == index].mean() == pytest.approx(spent, abs=0.05)
        assert (slots[~good] == 4).all()


def test_a_message_longer_than_the_limit_is_lost_without_a_draw() -> None:
    rng = np.random.default_rng(1)
    slots, good = link.drawn(9, 8, np.full(3, 0.9), rng)
    assert (slots.tolist(), good.any()) == ([8, 8, 8], False)
    assert rng.random() == np.random.default_rng(1).random()


def test_k_grows_from_the_horizon_to_the_zenith() -> None:
    laws = rice_by_elevation(5.0, 15.0)
    assert (laws[0], laws[45], laws[90]) == (rice(5.0), rice(10.0), rice(15.0))


@pytest.mark.parametrize(
    ("needed", "lost", "slots"), [(1, 2.56e-6, 1.24997632), (4, 0.0104064, 4.9020928), (7, 0.49668352, 3.81681664)]
)
def test_a_message_of_eight_slots(needed: int, lost: float, slots: float) -> None:
    success = np.array([0.8])
    assert link.lost(needed, 8, success) == pytest.approx([lost], abs=1e-9)
    assert link.delivered_slots(needed, 8, success) == pytest.approx([slots], abs=1e-8)


def test_a_queue_in_one_band_is_a_longer_message() -> None:
    for place, lost in ((16, 0.015577), (17, 0.119508), (18, 0.437366)):
        assert link.lost(4 * place, 90, np.array([0.8])) == pytest.approx([lost], abs=1e-6)


@every
def test_the_curves_are_the_closed_forms(law: Gain) -> None:
    margin_db = np.random.default_rng(1).uniform(-20, 40, 600)
    success = law.success(10.0 ** (-margin_db / 10.0))
    for needed in (1, 4, 8):
        lost, slots = Curves([STEADY, law], 8).at(needed, np.ones(600, dtype=np.intp), margin_db)
        np.testing.assert_allclose(lost, link.lost(needed, 8, success), atol=5e-4)
        np.testing.assert_allclose(slots, link.delivered_slots(needed, 8, success), atol=5e-3)


HELD = [  # margin in dB, needed slots, limit, law, loss with a shadow of 6 dB
    (10.0, 1, 1, RAYLEIGH, 0.171248),
    (10.0, 4, 8, RAYLEIGH, 0.078739),
    (10.0, 4, 8, nakagami(2.0), 0.058452),
    (12.0 - 5.0, 4, 8, nakagami(2.0), None),
    (6.0, 1, 1, STEADY, 0.158655),
]


@pytest.mark.parametrize(("margin_db", "needed", "most", "law", "expected"), HELD)
def test_a_shadow_is_held_for_the_whole_message(
    margin_db: float, needed: int, most: int, law: Gain, expected: float | None
) -> None:
    found, _ = Curves([law], most).shadowed(needed, 0, np.array([margin_db]), np.array([6.0]))
    if expected is None:
        z = np.linspace(-7, 7, 20_001)
        each = link.lost(needed, most, law.success(10.0 ** (-(margin_db + 6.0 * z) / 10.0)))
        expected = float(np.trapezoid(each * stats.norm.pdf(z), z))
    assert found == pytest.approx([expected], abs=1e-6)


def test_margins_beyond_the_table_are_those_at_its_ends() -> None:
    curves = Curves([RAYLEIGH], 8)
    far, near = (curves.at(1, np.zeros(2, dtype=np.intp), np.array(ends)) for ends in ([-900.0, 900.0], [-40.0, 60.0]))
    np.testing.assert_array_equal(far, near)
    assert (MARGINS_DB[0], MARGINS_DB[-1]) == (-40.0, 60.0)


def test_rates() -> None:
    assert [rates.cqi(index).efficiency for index in (1, 7, 15)] == [0.1523, 1.4766, 5.5547]
    assert [rates.cqi(index).threshold_db for index in (1, 7, 15)] == [-6.936, 4.694, 19.829]
    for rate in rates.CQI:  # each is Shannon's rate with a gap
        gap_db = rate.threshold_db - 10 * math.log10(2**rate.efficiency - 1)
        assert 1.5 - 0.05 < gap_db < 3.2 + 0.05
        assert rates.shannon(rate.threshold_db, gap_db).efficiency == pytest.approx(rate.efficiency)
    assert list(rates.CQI) == sorted(rates.CQI)
