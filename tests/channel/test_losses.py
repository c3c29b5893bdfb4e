"""Path losses beside numbers of other sources: ns-3's tests, an example of MATLAB, and tables of 3GPP by hand."""

import math
from functools import partial

import numpy as np
import pytest

from meanflock.channel.losses import aerial, plain, terrestrial
from meanflock.channel.losses.al_hourani import ENVIRONMENTS, al_hourani
from meanflock.channel.losses.model import Geometry, geometry
from meanflock.channel.losses.models import MODELS

WATTS, NS3_GHZ = 0.05035702, 2.398339664  # 17.0206 dBm at λ = 0.125 m


def over(ground_m: float, base_m: float, uav_m: float) -> Geometry:
    return geometry(np.array([ground_m]), np.array([base_m]), np.array([uav_m]))


def received(loss_db: np.ndarray) -> float:
    return float(WATTS * 10.0 ** (-loss_db[0] / 10.0))


@pytest.mark.parametrize(
    ("metres", "carrier_ghz", "loss_db"), [(1, 2.4, 40.0520), (100, 2.4, 80.0520), (500, 2.0, 92.4478)]
)
def test_free_space(metres: float, carrier_ghz: float, loss_db: float) -> None:
    assert plain.free_space(over(metres, 0, 0), carrier_ghz).clear_db == pytest.approx([loss_db], abs=1e-4)


@pytest.mark.parametrize(("metres", "watts"), [(100, 4.98265e-10), (500, 1.99306e-11), (2000, 1.24566e-12)])
def test_free_space_beside_ns3(metres: float, watts: float) -> None:
    assert received(plain.free_space(over(metres, 0, 0), NS3_GHZ).clear_db) == pytest.approx(watts, rel=1e-5)


@pytest.mark.parametrize(("metres", "watts"), [(10, 4.98265e-9), (20, 6.22831e-10), (80, 9.73173e-12)])
def test_log_distance_beside_ns3(metres: float, watts: float) -> None:
    for reference_db in (40.045997, None):
        found = plain.log_distance(over(metres, 0, 0), NS3_GHZ, exponent=3.0, reference_db=reference_db)
        assert received(found.clear_db) == pytest.approx(watts, rel=1e-5)


@pytest.mark.parametrize(("ground_m", "loss_db"), [(50, 70.5562), (100, 79.2555), (500, 88.8853)])
def test_two_rays(ground_m: float, loss_db: float) -> None:
    assert plain.two_ray(over(ground_m, 10, 2), 2.4).clear_db == pytest.approx([loss_db], abs=1e-4)


def test_two_rays_far_away_decay_as_the_fourth_power() -> None:
    found = plain.two_ray(over(50_000, 1.5, 1.5), 2.4).clear_db
    assert found == pytest.approx([40 * math.log10(50_000) - 20 * math.log10(1.5 * 1.5)], abs=1e-3)


NS3 = [  # at 5 GHz, terminal at 1.5 m: station's height, distance, loss with and without sight
    ("rma", 35, 10, 77.3784, 77.3784),
    ("rma", 35, 100, 87.2965, 95.7718),
    ("rma", 35, 1000, 108.5577, 133.5223),
    ("rma", 35, 5000, None, 160.5169),
    ("rma", 35, 10000, 140.3896, None),
    ("uma", 25, 10, 72.9380, 82.5131),
    ("uma", 25, 100, 86.2362, 106.1356),
    ("uma", 25, 1000, 109.7252, 144.7641),
    ("uma", 25, 5000, 137.6794, 172.0753),
    ("umi", 10, 10, 69.8591, 76.7563),
    ("umi", 10, 100, 88.4122, 107.9432),
    ("umi", 10, 1000, 119.3114, 143.1886),
    ("umi", 10, 5000, 147.2696, 167.8617),
]


@pytest.mark.parametrize(("name", "base_m", "ground_m", "clear_db", "blocked_db"), NS3)
def test_terrestrial_beside_ns3(
    name: str, base_m: float, ground_m: float, clear_db: float | None, blocked_db: float | None
) -> None:
    found = MODELS[name].losses(over(ground_m, base_m, 1.5), 5.0)
    for one, expected in ((found.clear_db, clear_db), (found.blocked_db, blocked_db)):
        assert expected is None or one == pytest.approx([expected], abs=5e-3)


def test_rural_beside_matlab() -> None:
    found = terrestrial.rma(over(math.hypot(1e3, 1e3), 30, 1.5), 3.5, building_m=7.0)
    assert found.clear_db == pytest.approx([110.1615], abs=1e-4)


SIGHT = [  # TR 38.901 Table 7.4.2-1, by hand
    ("rma", 1.5, 1010, math.exp(-1)),
    ("umi", 1.5, 36, 0.5 + 0.5 * math.exp(-1)),
    ("uma", 1.5, 63, 18 / 63 + (1 - 18 / 63) * math.exp(-1)),
    ("uma", 22.5, 150, (0.12 + 0.88 * math.exp(-150 / 63)) * (1 + 0.95**1.5 * 1.25 * 1.5**3 * math.exp(-1))),
    ("umi", 1.5, 10, 1.0),
]


@pytest.mark.parametrize(("name", "uav_m", "ground_m", "sight"), SIGHT)
def test_sight_near_the_ground(name: str, uav_m: float, ground_m: float, sight: float) -> None:
    base_m = MODELS[name].validity.base_m[0]
    for called in (name, f"{name}-av"):
        found = MODELS[called].losses(over(ground_m, base_m, uav_m), 2.0)
        assert found.sight == pytest.approx([sight], abs=1e-6)


AERIAL = [  # at 2 GHz and d₂ = 500 m: sight, losses, deviation in sight
    ("rma-av", 35, 30, 0.983297, 95.7921, 99.7974, 3.6586),
    ("uma-av", 25, 30, 0.828456, 93.3984, 117.2088, 3.8065),
    ("uma-av", 25, 50, 0.888749, 93.4099, 113.0352, 3.3358),
    ("uma-av", 25, 100, 0.944602, 93.5042, 107.4840, 2.3982),
    ("umi-av", 10, 50, 0.378936, 94.7096, 120.2085, 3.0327),
    ("umi-av", 10, 100, 0.546735, 94.4208, 114.1856, 2.0000),
    ("air-to-air", 50, 50, 0.888749, 94.6799, 120.1665, 3.0327),
]


@pytest.mark.parametrize(("name", "base_m", "uav_m", "sight", "clear_db", "blocked_db", "sigma_db"), AERIAL)
def test_aerial(
    name: str, base_m: float, uav_m: float, sight: float, clear_db: float, blocked_db: float, sigma_db: float
) -> None:
    found = MODELS[name].losses(over(500, base_m, uav_m), 2.0)
    assert found.sight == pytest.approx([sight], abs=1e-6)
    assert (found.clear_db[0], found.blocked_db[0]) == pytest.approx((clear_db, blocked_db), abs=1e-4)
    assert found.clear_sigma_db == pytest.approx([sigma_db], abs=1e-4)
    assert found.blocked_sigma_db == [8.0 if name in ("umi-av", "air-to-air") else 6.0]


def test_uavs_see_each_other_above_100_m() -> None:
    near = aerial.air_to_air(over(100, 50, 50), 2.0)
    assert near.sight == pytest.approx([0.994805], abs=1e-6)
    assert (near.clear_db[0], near.blocked_db[0]) == pytest.approx((79.7216, 98.9963), abs=1e-4)
    assert aerial.air_to_air(over(4000, 50, 101), 2.0).sight == [1.0]
    low = aerial.air_to_air(over(500, 20, 50), 2.0)
    assert low.sight == aerial.umi_av(over(500, 20, 50), 2.0).sight


TOWNS = [  # sight at 10, 30, 45, 60, 80°; sight and mean loss at (d₂, h) = (100, 100), (300, 100), (500, 50) m
    ("suburban", (0.649412, 0.999901, 1, 1, 1), (1, 0.985846, 0.226533), (81.5787, 88.8642, 108.7564)),
    (
        "urban",
        (0.099714, 0.730979, 0.967692, 0.996980, 0.999877),
        (0.967692, 0.299262, 0.052814),
        (83.0925, 102.7824, 111.4875),
    ),
    (
        "dense-urban",
        (0.061783, 0.372770, 0.755774, 0.941566, 0.993170),
        (0.755774, 0.142766, 0.039461),
        (88.3051, 108.4132, 114.6465),
    ),
    (
        "highrise",
        (0.009169, 0.043826, 0.132077, 0.335655, 0.714488),
        (0.132077, 0.017847, 0.006523),
        (111.2918, 121.9026, 126.2842),
    ),
]


@pytest.mark.parametrize(("town", "by_angle", "by_place", "mean_db"), TOWNS)
def test_al_hourani(
    town: str, by_angle: tuple[float, ...], by_place: tuple[float, ...], mean_db: tuple[float, ...]
) -> None:
    loss = partial(al_hourani, environment=ENVIRONMENTS[town])
    for degrees, sight in zip((10, 30, 45, 60, 80), by_angle, strict=True):
        found = loss(over(100.0, 0.0, 100.0 * math.tan(math.radians(degrees))), 2.0)
        assert found.sight == pytest.approx([sight], abs=1e-6)
    for (ground_m, height_m), sight, mean in zip(((100, 100), (300, 100), (500, 50)), by_place, mean_db, strict=True):
        found = loss(over(ground_m, 0.0, height_m), 2.0)
        assert found.sight == pytest.approx([sight], abs=1e-6)
        mixed = found.sight * found.clear_db + (1 - found.sight) * found.blocked_db
        assert mixed == pytest.approx([mean], abs=1e-4)


@pytest.mark.parametrize("name", MODELS)
def test_a_loss_is_finite_and_grows_without_sight_in_all_of_its_range(name: str) -> None:
    model = MODELS[name]
    axes = [np.unique(np.clip((0, 1, 12, 50, 300, 4e3), *limits)) for limits in model.validity[:3]]
    ends = [axis.ravel() for axis in np.meshgrid(*axes)]
    losses, outside = model.validity.clamped(*ends)
    found = model.losses(losses, 2.0)
    assert not outside.any()
    assert all(np.isfinite(array).all() for array in found)
    assert (found.blocked_db >= found.clear_db).all()
    assert ((found.sight >= 0) & (found.sight <= 1)).all()
    assert model.has_sight == bool((found.blocked_db > found.clear_db).any())
    assert (model.correlation_m is None) == (not found.blocked_sigma_db.any())


def test_what_is_outside_a_range_is_named_and_moved_to_its_end() -> None:
    validity = MODELS["uma-av"].validity
    ground, base, uav = np.array([100.0, 5000.0]), np.array([25.0, 30.0]), np.array([310.0, 50.0])
    moved, outside = validity.clamped(ground, base, uav)
    assert outside.tolist() == [True, True]
    assert (moved.ground_m[1], moved.base_m[1], moved.uav_m[0]) == (4000.0, 25.0, 300.0)
    assert validity.fault(ground, base[:1], uav[1:], 2.0) == "a horizontal distance of 5000 m is outside 0 to 4000 m"
    assert validity.fault(ground[:1], base[:1], uav[1:], 2.0) is None
    assert validity.fault(ground[:1], base[:1], uav[1:], 0.1) == "a carrier of 0.1 GHz is outside 0.5 to 100 GHz"
