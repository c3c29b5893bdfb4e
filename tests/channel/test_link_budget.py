"""The channel `link-budget`: foreseen beside drawn losses, its range, its memory, and the options it refuses."""

from itertools import product
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.channel.base import Message
from meanflock.channel.fading.link_budget import LinkBudget
from meanflock.channel.losses.models import MODELS
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.testing import check_channel

UAVS, BITS = 12, 7872
BLOCKS, MESSAGES = 30, 6
AIR = ("free-space", "log-distance", "two-ray", "air-to-air")
MAST_M = {"rma": 35.0, "rma-av": 35.0, "uma": 25.0, "uma-av": 25.0, "umi": 10.0, "umi-av": 10.0}
LOW = ("uma", "umi", "rma")  # their terminals stand near the ground


def scenario(*settings: str, uavs: int = UAVS, mast_m: float | None = None) -> Scenario:
    """`mast_m`: height of a station 150 m from the origin; None: there is no station."""
    stations = [] if mast_m is None else [f"stations=[{{place=[150.0, 0.0, {mast_m}]}}]"]
    return load(None, [f"uavs={uavs}", "radio.coherence_time_s=0.001", "federation.leader=0", *stations, *settings])


def made(flown: Scenario, **options: Any) -> LinkBudget:
    channel: LinkBudget = plugins.create("channel", "link-budget", options, flown)
    return channel


def between_uavs(position_m: np.ndarray, tick: int = 0, bits: int = BITS) -> Message:
    source, target = np.nonzero(~np.eye(len(position_m), dtype=bool))
    distance = np.linalg.norm(position_m[source] - position_m[target], axis=-1)
    return Message(tick, bits, source, target, distance, position_m)


def to_station(position_m: np.ndarray, tick: int = 0, bits: int = BITS) -> Message:
    """Uploads of all UAVs in three fragments."""
    source = np.arange(len(position_m)).repeat(3)
    return Message(tick, bits, source, np.full(len(source), len(position_m)), np.zeros(len(source)), position_m)


CASES = [
    (kind, loss, sigma_db, fading)
    for kind, losses, fadings in (
        ("air", AIR, ("none", "rayleigh", "rice", "nakagami")),
        (
            "ground",
            [name for name in MODELS if name != "air-to-air"],
            ("none", "rayleigh", "rice-elevation", "nakagami"),
        ),
    )
    for loss, sigma_db, fading in product(losses, (None, 6.0), fadings)
]


@pytest.mark.parametrize(("kind", "loss", "sigma_db", "fading"), CASES)
def test_what_happens_is_what_is_foreseen(kind: str, loss: str, sigma_db: float | None, fading: str) -> None:
    prefix, height = ("air_", 40.0) if kind == "air" else ("", 1.5 if loss in LOW else 40.0)
    options: dict[str, Any] = {f"{prefix}loss": loss, f"{prefix}fading": fading}
    if sigma_db is not None:
        options[f"{prefix}sigma_db"] = sigma_db
    mast_m = MAST_M.get(loss, 1.5) if kind == "ground" else None
    walk, rng = np.random.default_rng(4), np.random.default_rng(3)
    position_m = walk.uniform(-120, 120, (UAVS, 2))
    message = between_uavs if kind == "air" else to_station
    shape = (f"start.height={height}", "radio.latency_threshold_slots=6")
    at_0_dbm = made(scenario(*shape, "radio.tx_power_dbm=0", mast_m=mast_m), **options)
    median_db = np.median(at_0_dbm._state(message(position_m))[0])
    channel = made(scenario(*shape, f"radio.tx_power_dbm={3.0 - median_db}", mast_m=mast_m), **options)
    memory, apart = channel.init(UAVS), np.zeros((BLOCKS, MESSAGES, 2))
    share = 0.0
    for tick in range(BLOCKS * MESSAGES):
        position_m = np.clip(position_m + walk.normal(0, 15, position_m.shape), -120, 120)
        now = message(position_m, tick)
        lost, spent = channel.foreseen(memory, now)
        assert lost.min() >= 0 <= spent.min()
        assert lost.max() <= 1
        memory, slots, delivered = channel.carry(memory, now, rng)
        apart.reshape(-1, 2)[tick] = (~delivered).sum() - lost.sum(), slots[delivered].sum() - spent.sum()
        share += lost.mean() / (BLOCKS * MESSAGES)
    assert 0.01 < share < 0.99
    blocks = apart.mean(axis=1)
    error = blocks.std(axis=0, ddof=1) / np.sqrt(BLOCKS)
    assert (np.abs(blocks.mean(axis=0)) <= 4 * error + 1e-9).all()


@pytest.mark.parametrize("options", [{"air_sigma_db": 6.0}, {"air_loss": "air-to-air", "air_fading": "nakagami"}])
def test_the_mean_over_worlds_is_the_closed_form_of_a_distance(options: dict[str, Any]) -> None:
    position_m = np.array([[0.0, 0.0], [260.0, 0.0]])
    settings = ("radio.tx_power_dbm=-15", "radio.latency_threshold_slots=6")
    if "air_loss" in options:
        settings = ("radio.tx_power_dbm=-8", *settings[1:])
    found = []
    for seed in range(400):
        channel = made(scenario(*settings, f"seed={seed}", uavs=2), **options)
        found.append([sums[0] for sums in channel.foreseen(channel.init(2), between_uavs(position_m))])
    expected = np.array(channel.expected(np.array([260.0]), BITS))
    assert 0.001 < expected[0] < 0.99
    error = np.std(found, axis=0) / np.sqrt(len(found))
    assert (np.abs(np.mean(found, axis=0) - expected) <= 4 * error + 1e-6).all()


def test_the_budget_decides_the_range() -> None:
    """20 dBm, 2.4 GHz, 2 MHz and 7 dB of noise figure are 43.94 dB at 100 m; CQI 7 needs 4.694 dB."""
    channel = made(scenario(uavs=2), air_fading="none")
    snr_db = 20.0 - 80.0520 - (-174.0 + 10 * np.log10(2e6) + 7.0)
    assert snr_db == pytest.approx(43.94, abs=0.01)
    reach_m = 100.0 * 10.0 ** ((snr_db - 4.694) / 20.0)
    for ratio, lost in ((0.999, 0.0), (1.001, 1.0)):
        message = between_uavs(np.array([[0.0, 0.0], [ratio * reach_m, 0.0]]))
        memory, _, delivered = channel.carry(channel.init(2), message, np.random.default_rng(1))
        assert channel.foreseen(memory, message)[0].tolist() == [lost, lost]
        assert (1.0 - delivered).tolist() == [lost, lost]
    assert channel.bits_per_slot == pytest.approx(0.001 * 2e6 * 1.4766)
    assert channel.least_slots(BITS) == 3
    for key, change_db in ((("gain_dbi", 3.0), 6.0), (("noise_figure_db", 10.0), -3.0)):
        changed = made(scenario(uavs=2), air_fading="none", **dict([key]))
        apart = changed._state(message)[0] - channel._state(message)[0]
        assert apart == pytest.approx([change_db, change_db])


def test_a_flight_loses_what_theory_expects() -> None:
    options = {"air_sigma_db": 6.0, "air_fading": "nakagami"}
    run = mf.fly(
        "paper",
        method="vasarhelyi",
        uavs=8,
        duration=20,
        **{
            "radio.model": "link-budget",
            "radio.options": options,
            "radio.tx_power_dbm": -48.0,
            "radio.coherence_time_s": 0.001,
        },
    )
    radio = run.summary["radio"]
    assert 0.02 < radio["outage_rate"] < 0.98
    assert radio["outage_rate"] == pytest.approx(radio["outage_rate_theory"], abs=0.01)


def test_shannon_s_rate_has_the_scenario_s_threshold() -> None:
    channel = made(scenario("radio.target_snr_db=10"), rate="shannon", gap_db=3.0)
    assert channel.bits_per_slot == pytest.approx(0.001 * 2e6 * np.log2(1 + 10**0.7))


def test_both_directions_fare_the_same_and_a_second_channel_sees_the_same_world() -> None:
    options = {"loss": "uma-av", "air_loss": "air-to-air", "air_sigma_db": 8.0}
    one, other = (made(scenario("radio.tx_power_dbm=-5", mast_m=25.0), **options) for _ in range(2))
    position_m = np.random.default_rng(2).uniform(-200, 200, (UAVS, 2))
    up = np.concatenate([np.repeat(np.arange(UAVS), UAVS), np.arange(UAVS)])
    down = np.concatenate([np.tile(np.arange(UAVS), UAVS), np.full(UAVS, UAVS)])
    up, down = up[up != down], down[up != down]
    there = one.foreseen({}, Message(0, BITS, up, down, np.zeros(len(up)), position_m))
    back = other.foreseen({}, Message(9, BITS, down, up, np.zeros(len(up)), position_m))
    np.testing.assert_array_equal(there, back)


def test_links_outside_the_validity_are_counted_and_treated_as_at_its_end() -> None:
    channel = made(scenario(mast_m=25.0), loss="uma-av")
    position_m = np.zeros((UAVS, 2))
    position_m[:3, 0] = 150.0 + 4000.0, 150.0 + 5000.0, 9e9
    message = to_station(position_m)
    memory, *_ = channel.carry(channel.init(UAVS + 1), message, np.random.default_rng(1))
    assert memory["clamped"].tolist() == [6]  # fragments of UAVs 1 and 2
    memory, *_ = channel.carry(memory, message, np.random.default_rng(1))
    assert memory["clamped"].tolist() == [12]
    assert np.isfinite(channel.foreseen(memory, message)).all()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"air_fading": "none", "air_sigma_db": 6.0, "correlation_m": 10.0},
        {"air_loss": "air-to-air", "air_fading": "nakagami", "air_m": 0.7},
        {"air_loss": "two-ray", "air_fading": "rayleigh", "rate": "shannon"},
        {"air_loss": "log-distance", "exponent": 3.0, "reference_db": 60.0, "cqi": 1},
    ],
    ids=str,
)
def test_it_conforms(options: dict[str, Any]) -> None:
    settings = ["radio.tx_power_dbm=-5", "radio.target_snr_db=5", "radio.coherence_time_s=0.001"]
    check_channel(LinkBudget, options, load(None, settings))


REFUSED = [
    ({"loss": "uma-av"}, "radio.options.loss has no effect without [[stations]]: add that"),
    ({"loss": "al-hourani"}, "radio.options.loss has no effect without [[stations]]"),
    ({"air_loss": "uma-av"}, "uma-av"),
    ({"k_db": 3.0}, "radio.options.k_db has no effect without [[stations]] and fading = 'rice'"),
    ({"air_m": 3.0}, "radio.options.air_m has no effect without air_fading = 'nakagami'"),
    ({"gap_db": 3.0}, "radio.options.gap_db has no effect without rate = 'shannon'"),
    ({"exponent": 3.0}, "radio.options.exponent has no effect without a path loss 'log-distance'"),
    ({"environment": "highrise"}, "radio.options.environment has no effect without loss = 'al-hourani'"),
    ({"cqi": 16}, "cqi"),
    ({"air_fading": "rice-elevation"}, "rice-elevation"),
    ({"air_loss": "air-to-air", "carrier_ghz": 0.2}, "a carrier of 0.2 GHz is outside 0.5 to 100 GHz"),
]


@pytest.mark.parametrize(("options", "text"), REFUSED, ids=lambda given: str(given)[:40])
def test_bad_options_are_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(BadInput) as raised:
        made(scenario(), **options)
    assert text in str(raised.value)


def test_starts_outside_the_validity_are_refused() -> None:
    with pytest.raises(
        BadInput, match=r"radio\.options\.loss = 'uma-av': a height of the UAV of 400 m is outside 1\.5"
    ):
        made(scenario("start.height=400", mast_m=25.0), loss="uma-av")
    with pytest.raises(BadInput, match=r"'uma-av': a horizontal distance of .* is outside 0 to 4000 m"):
        made(scenario("start.centre=[9000,0]", mast_m=25.0), loss="uma-av")
    with pytest.raises(BadInput, match=r"'umi': a height of the station or lower UAV of 25 m is outside 10 to 10 m"):
        made(scenario("start.height=1.5", mast_m=25.0), loss="umi")
    with pytest.raises(BadInput, match=r"air_loss = 'air-to-air': a height of the station or lower UAV of 1 m"):
        made(scenario("start.height=1", mast_m=25.0), loss="free-space", air_loss="air-to-air")
    with pytest.raises(BadInput, match=r"'air-to-air' is of UAVs only; set radio\.options\.loss"):
        made(scenario(mast_m=25.0), air_loss="air-to-air")
