"""Radios that differ from node to node: what each sends, hears and spends, and noise of a jammer."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.channel.base import Message
from meanflock.channel.fading.link_budget import LinkBudget
from meanflock.federation.band import duties
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.faults.dying import LATER, dead, resumed
from tests.golden.flights import steady
from tests.telemetry import fly

BUDGET = ("radio.model=link-budget", "radio.coherence_time_s=0.001", "uavs=4")
JAMMER = {"kind": "noise", "tick": 0, "duration_s": 30.0, "power_dbm": 20.0, "bandwidth_hz": 2e6}


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, [*BUDGET, *settings], **options)


def channel_of(flown: Scenario) -> LinkBudget:
    channel: LinkBudget = plugins.create("channel", "link-budget", flown.radio.options, flown)
    return channel


def margins(flown: Scenario, noise: Any = None) -> np.ndarray:
    """Margins (N, N) between UAVs on a line, 100 m apart, dB."""
    position_m = np.stack([100.0 * np.arange(flown.uavs), np.zeros(flown.uavs)], axis=-1)
    source, target = np.nonzero(~np.eye(flown.uavs, dtype=bool))
    distance = np.abs(position_m[source, 0] - position_m[target, 0])
    message = Message(0, 100, source, target, distance, position_m, noise=noise)
    table = np.zeros((flown.uavs, flown.uavs))
    table[source, target] = channel_of(flown).signal_db(message)
    return table


def test_a_radio_of_its_own_counts_where_it_sends_and_where_it_receives() -> None:
    alike = margins(scenario())
    own = margins(scenario("radios=[{uavs=[1], tx_power_dbm=30.0, gain_dbi=3.0}, {uavs=[2], noise_figure_db=12.0}]"))
    change = own - alike
    np.testing.assert_allclose(change[1, [0, 3]], 13.0)
    np.testing.assert_allclose(change[[0, 3], 1], 3.0)
    np.testing.assert_allclose(change[[0, 3], 2], -5.0)
    np.testing.assert_allclose(change[1, 2], 8.0)
    np.testing.assert_allclose(change[[0, 3, 2], [3, 0, 0]], 0.0)


def test_a_jammer_of_20_dbm_at_300_m_is_34_4_db_above_the_noise() -> None:
    flown = scenario("start.height=40", uavs=2)
    far = margins(flown) - margins(flown, np.array([[400.0, 0.0, 40.0, 20.0, 2e6]]))
    assert far[0, 1] == pytest.approx(34.4, abs=0.05)
    wide = margins(flown) - margins(flown, np.array([[400.0, 0.0, 40.0, 20.0, 2e8]]))
    assert wide[0, 1] == pytest.approx(14.5, abs=0.1)  # a hundredth of it is in the band
    none = margins(flown) - margins(flown, np.array([[400.0, 0.0, 40.0, 20.0, 2e6]] * 2))
    assert none[0, 1] == pytest.approx(37.4, abs=0.05)


def test_under_noise_as_much_is_lost_as_theory_says() -> None:
    faults = [{**JAMMER, "place": [250.0, 150.0, 40.0]}]
    flown = scenario("radio.tx_power_dbm=0", "federation.period=5", "uavs=25", faults=faults, duration=30)
    links = Engine(flown, "noise").complete()["radio"]["traffic"]["uplink"]
    lost, sent = links["outage_rate"], links["sent"]
    assert 0.02 < lost < 0.98
    assert abs(lost - links["outage_rate_theory"]) < 4 * np.sqrt(lost * (1 - lost) / sent)


def test_a_node_spends_what_it_sends_hears_and_waits() -> None:
    spends = ("energy.radio_W=2", "energy.receive_W=1.5", "energy.idle_W=1")
    faults = [{"kind": "kill", "tick": 100, "uavs": [3]}]
    station = ("stations=[{place=[0.0, 0.0, 25.0]}]", "federation.station=0")
    flown = scenario(*spends, *station, "federation.period=20", "stop=duration", duration=20, faults=faults)
    summary = Engine(flown, "energy").complete()
    rows = np.array(summary["radio"]["nodes"])
    assert rows.shape == (5, 4)
    powered_s = np.array([20.0, 20.0, 20.0, 10.0, 20.0])
    _, sent_s, heard_s, energy_J = rows.T
    np.testing.assert_allclose(energy_J, 2 * sent_s + 1.5 * heard_s + (powered_s - sent_s - heard_s))
    assert sent_s.sum() == pytest.approx(summary["radio"]["airtime_s"])
    assert summary["energy_radio_J"] == pytest.approx(energy_J[:4].sum())  # a station has its own power
    assert summary["radio"]["duty_max"] == pytest.approx(sent_s.max() / 20.0)


def test_who_is_lost_or_sleeps_spends_and_hears_nothing() -> None:
    spends = ("energy.receive_W=1.5", "energy.idle_W=1", "stations=[{place=[0.0, 0.0, 25.0]}]", "federation.station=0")
    faults = [
        {"kind": "kill", "tick": 10, "uavs": [3]},
        {"kind": "kill", "tick": 100, "stations": [0]},
        {"kind": "pause", "tick": 0, "duration_s": 60.0, "uavs": [2]},
    ]
    flown = scenario(*spends, "federation.period=20", "stop=duration", duration=20, faults=faults)
    rows = np.array(Engine(flown, "asleep").complete()["radio"]["nodes"])
    assert rows[[2, 3], 2].tolist() == [0.0, 0.0]
    assert (rows[:2, 2] > 0).all()
    assert rows[3, 3] == pytest.approx(1.0)
    assert rows[4, 3] == pytest.approx(10.0 - rows[4, 1] + 0.5 * rows[4, 2])


def test_a_station_is_judged_in_its_own_band() -> None:
    def planned(band_hz: float, limit: float) -> Any:
        mast = f"stations=[{{place=[0.0, 0.0, 25.0], bandwidth_hz={band_hz}}}]"
        return plan_of(scenario(mast, "federation.station=0", f"radio.duty_max={limit}", "federation.period=50"))

    slots = {2e6: 3, 2e5: 27, 1e8: 1}  # of a global model of 7,872 bits; 2,953 in a slot of 2 MHz
    for band_hz, expected in slots.items():
        plan = planned(band_hz, 1.0)
        station = duties(plan)[4]
        least = expected * 0.001 / 5.0
        assert least <= station < 1.2 * least if band_hz != 2e5 else station == pytest.approx(8 * 0.001 / 5.0)
    with pytest.raises(BadInput, match="station 0 would send models"):
        planned(2e5, 0.001)


def test_noise_counts_in_the_band_of_the_message() -> None:
    flown = scenario("start.height=40", "stations=[{place=[0.0, 0.0, 40.0], bandwidth_hz=1e7}]", uavs=2)
    channel, place = channel_of(flown), np.array([[100.0, 0.0], [200.0, 0.0], [0.0, 0.0]])
    noise = np.array([[0.0, 300.0, 40.0, 20.0, 2e6]])
    down = Message(0, 100, np.array([2]), np.array([0]), np.array([100.0]), place)
    distance_m = np.hypot(100.0, 300.0)
    fell = channel.signal_db(down) - channel.signal_db(down._replace(noise=noise))
    heard_db = 34.4 - 20.0 * np.log10(distance_m / 300.0) - 10.0 * np.log10(5.0)
    assert fell[0] == pytest.approx(heard_db, abs=0.1)


def test_loads_go_on_after_a_kill(tmp_path: Path) -> None:
    flown = scenario("energy.idle_W=1", "energy.radio_W=3", LATER, faults=[{"kind": "kill", "tick": 150, "uavs": [2]}])
    whole = Engine(flown, "whole").complete()
    again = resumed(dead(tmp_path, flown, 210, rows=2))
    assert again["radio"]["nodes"] == whole["radio"]["nodes"]
    assert again["energy_radio_J"] == whole["energy_radio_J"]


THIN = ("radio.bandwidth_hz=250e3", "radio.latency_threshold_slots=90", "radio.access=tdma")


def test_a_round_that_sends_for_longer_than_a_radio_may_is_refused_with_the_least_period() -> None:
    def planned(period: int) -> Any:
        return plan_of(scenario(*THIN, f"federation.period={period}", "radio.duty_max=0.005", "federation.fraction=1"))

    with pytest.raises(
        BadInput, match=r"`radio.duty_max` is 0.005, and UAV 0 would send .* `federation.period`"
    ) as told:
        planned(20)
    least = int(str(told.value).split("to ")[1].split()[0])
    assert planned(least).period_ticks == least
    with pytest.raises(BadInput, match=f"to {least} at least"):
        planned(least - 1)


@pytest.mark.parametrize("method", ["mfgfl-hf", "hjb"])
def test_radios_send_as_long_as_is_foreseen_and_who_sends_more_is_named_once(method: str, monkeypatch) -> None:
    monkeypatch.setattr("meanflock.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
    limit = {"mfgfl-hf": 0.012, "hjb": 0.0005}[method]
    flown = scenario(
        *THIN, "federation.period=20", f"radio.duty_max={limit}", "stop=duration", duration=20, method=method
    )
    summary, record = fly(flown)
    told = [event for event in record.events if event.kind == "duty"]
    plan = plan_of(flown)
    if method == "mfgfl-hf":
        assert not told
        assert summary["radio"]["duty_max"] == pytest.approx(duties(plan).max(), rel=0.2)
    else:
        named = [name for event in told for name in event.nodes]
        assert sorted(named) == [f"UAV {uav}" for uav in range(4)]
        assert "has sent for more than 0.05 % of the time" in told[0].text
        again, rest = fly(flown, resume=record.checkpoints[-1])
        assert "duty" not in [event.kind for event in rest.events]
        assert steady(again) == steady(summary)


def test_collisions_are_on_the_air_of_those_who_collide() -> None:
    flown = scenario("radio.access=csma", "federation.period=20", "stop=duration", duration=20, uavs=9)
    radio = Engine(flown, "csma").complete()["radio"]
    assert sum(row[1] for row in radio["nodes"]) == pytest.approx(radio["airtime_s"])
    assert radio["airtime_s"] > sum(row[2] for row in radio["nodes"] if row[0] == 0)


@pytest.mark.parametrize(
    ("settings", "options", "text"),
    [
        (("radios=[{uavs=[4], gain_dbi=1.0}]",), {}, r"`radios\[0\].uavs` names UAV 4 of 0…3"),
        (
            ("radios=[{uavs=[1], gain_dbi=1.0}, {uavs=[1], gain_dbi=2.0}]",),
            {},
            r"`radios\[1\].uavs` names UAV 1, which has a radio",
        ),
        (("radios=[{gain_dbi=1.0}]",), {}, "uavs"),
        (("radios=[{uavs=[0], gain_dbi=nan}]",), {}, "gain_dbi"),
        (("radios=[{uavs=[0]}]",), {}, "differs in `tx_power_dbm`"),
        (("radios=[{uavs=[0], gain_dbi=1.0}]", "radio.model=rice"), {}, "the channel rice has one radio for all"),
        (("radio.model=rice",), {"faults": [{**JAMMER, "place": [0.0, 0.0, 1.0]}]}, "the channel rice does not hear"),
        ((), {"faults": [{**JAMMER, "place": [0.0, 0.0]}]}, "place"),
    ],
)
def test_what_radios_cannot_be_is_refused(settings: tuple[str, ...], options: dict[str, Any], text: str) -> None:
    with pytest.raises((BadInput, ValueError), match=text):
        plan_of(scenario(*settings, **options))
