"""Stations: who averages where and when, what goes over which link, and that no flight knows of them otherwise."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.channel.base import Channel
from meanflock.channel.serving import Serving
from meanflock.federation.plan import plan_of
from meanflock.federation.seat import seat
from meanflock.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import RoundEnded
from meanflock.swarm.scenario import Scenario, load
from tests.faults.dying import LATER, dead, resumed, steady

MAST = "stations=[{place=[0.0, 0.0, 25.0]}]"
THREE = "stations=[{place=[0.0, 0.0, 25.0]}, {place=[150.0, 150.0, 25.0]}, {place=[60.0, 120.0, 2.0]}]"
SHORT = ("uavs=6", "federation.period=20", "federation.station=0", "radio.target_snr_db=60", "stop=duration")
BOTH = pytest.mark.parametrize("settings", [(MAST,), (THREE, "federation.topology=stations")])


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, [*SHORT, *settings], **options)


def kill(station: int, tick: int, **more: Any) -> dict[str, Any]:
    return {"kind": "kill", "tick": tick, "stations": [station], **more}


def pause(station: int, tick: int, duration_s: float) -> dict[str, Any]:
    return {"kind": "pause", "tick": tick, "duration_s": duration_s, "stations": [station]}


def rounds(flown: Scenario, **options: Any) -> tuple[dict[str, Any], list[Any]]:
    """The summary of a flight, and the rounds in it."""
    told: list[Any] = []

    class Sink:
        def write(self, block: Any) -> None:
            told.extend(event for event in block.events if isinstance(event, RoundEnded))

    return Engine(flown, "stations", sinks=[Sink()], **options).complete(), told


@pytest.mark.parametrize(
    ("station", "faults", "tick", "node"),
    [
        (0, [], 0, 6),
        (1, [], 0, 7),
        (1, [kill(1, 50)], 49, 7),
        (1, [kill(1, 50)], 50, 8),
        (1, [kill(1, 50), kill(2, 50)], 50, 6),
        (1, [kill(1, 50), kill(2, 50), kill(0, 60)], 60, 2),
        (0, [pause(0, 50, 1.0)], 55, 7),
        (0, [pause(0, 50, 1.0)], 60, 6),
    ],
)
def test_the_leader_averages_at_the_first_station_that_is_there(
    station: int, faults: list[Any], tick: int, node: int
) -> None:
    flown = scenario(THREE, f"federation.station={station}", "federation.leader=2", faults=faults)
    assert seat(flown, tick) == node


def test_a_lost_station_is_followed_by_the_next_one_and_then_by_the_uav() -> None:
    faults = [kill(0, 30), pause(1, 35, 2.0), kill(1, 70), kill(2, 90)]
    summary, told = rounds(scenario(THREE, "duration=12", faults=faults))
    assert [each.outcome for each in told] == ["averaged"] * 5
    assert [each.station for each in told] == [0, 2, 1, 2, None]
    assert [each.receiver for each in told] == [None] * 4 + [0]
    assert "received by station 2; averaged and broadcast" in told[1].text
    assert summary["rounds"] == 5


def test_a_round_whose_station_is_lost_in_between_is_void() -> None:
    slow = ("radio.coherence_time_s=0.05",)  # so uploads take some ticks
    _, told = rounds(scenario(MAST, *slow, "duration=6", faults=[kill(0, 21)]))
    assert told[0].outcome == "void"
    assert told[0].reason == "station 0, which averages, is lost or paused"
    assert told[1].receiver == 0


def test_every_uav_uploads_by_radio_and_the_loss_of_any_ends_no_round() -> None:
    calm, _ = rounds(scenario(MAST, "duration=6", "federation.fraction=1"))
    sources = {source for source, target, *_ in calm["radio"]["links"] if target == 6}
    assert sources == set(range(6))
    assert {target for source, target, *_ in calm["radio"]["links"] if source == 6} == set(range(6))
    lost, told = rounds(scenario(MAST, "duration=8", faults=[{"kind": "kill", "tick": 30, "uavs": [0]}]))
    assert lost["rounds"] == 3
    assert [each.outcome for each in told] == ["averaged"] * 3


def test_a_flight_without_rounds_does_not_know_of_stations() -> None:
    flown = scenario(THREE, "method=hjb", "duration=5")
    with_them, _ = rounds(flown)
    without, _ = rounds(flown.replace(stations=[], federation={"period": 20}))
    assert [row[1] for row in with_them["radio"].pop("nodes")[6:]] == [0.0] * 3  # what the stations sent
    without["radio"].pop("nodes")
    but = ("scenario_sha256", "run_id")
    assert steady(with_them, *but) == steady(without, *but)


@pytest.mark.parametrize("kind", ["partition", "jam"])
def test_a_station_that_is_cut_off_receives_nothing(kind: str) -> None:
    where = {"stations": [0]} if kind == "partition" else {"centre": [0.0, 0.0], "radius_m": 5.0}
    fault = {"kind": kind, "tick": 0, "duration_s": 3.0, **where}
    _, told = rounds(scenario(MAST, "duration=6", faults=[fault]))
    assert [each.outcome for each in told] == ["void", "averaged"]
    assert not told[0].received


def test_stations_serve_whom_they_hear_best_and_what_they_hand_over_is_counted() -> None:
    two = "stations=[{place=[100.0, 150.0, 2.0]}, {place=[200.0, 150.0, 2.0]}]"
    summary, told = rounds(scenario(two, "federation.topology=stations", "duration=6", "federation.fraction=1"))
    uploads = {(source, target) for source, target, *_ in summary["radio"]["links"] if source < 6}
    assert {target for _, target in uploads} == {6, 7}
    assert told[0].arrived == 6
    bits = summary["payload_bits"]["uplink"] // 12  # of one model
    elsewhere = sum(sent for source, target, sent, _ in summary["radio"]["links"] if source < 6 and target != 6)
    others = len(told) * len({source for source, *_ in summary["radio"]["links"] if source > 6})
    assert summary["radio"]["backhaul_bits"] == bits * (elsewhere + others)
    assert summary["radio"]["delivered"] == 2 * 12


def test_the_wire_ends_at_stations() -> None:
    """Stations sleep in the tick in which a round opens, so that the UAV averages it, and wake up before it ends."""
    two = "stations=[{place=[100.0, 150.0, 2.0]}, {place=[200.0, 150.0, 2.0]}]"
    asleep = {"kind": "pause", "tick": 20, "duration_s": 0.1, "stations": [0, 1]}
    flown = scenario(two, "federation.topology=stations", "federation.fraction=1", "duration=3.5", faults=[asleep])
    summary, (ended,) = rounds(flown)
    assert (ended.receiver, ended.station, ended.reached) == (0, None, 5)
    assert summary["radio"]["backhaul_bits"] == 0
    assert {source for source, *_ in summary["radio"]["links"]} == set(range(6))


def test_a_round_in_one_band_has_room_for_the_broadcasts_of_all_stations() -> None:
    ring = [{"place": [150.0 + 30.0 * math.cos(at), 150.0 + 30.0 * math.sin(at), 2.0]} for at in range(6)]
    slow = ("radio.coherence_time_s=0.05", "radio.access=tdma", "federation.topology=stations", "uavs=12")
    with pytest.raises(BadInput, match=r"take at least (\d+)") as told:
        plan_of(scenario(*slow, "federation.period=2", stations=ring))
    least = int(str(told.value).rsplit(" ", 1)[1])
    summary, ended = rounds(scenario(*slow, f"federation.period={least}", "duration=60", stations=ring))
    assert summary["rounds_void"] == 0
    assert summary["uploads_late"] == 0
    assert all(each.reached == 12 for each in ended)


def test_a_uav_changes_its_station_once_another_is_stronger_for_long() -> None:
    serving = Serving(scenario(THREE, uavs=1))
    both = np.ones(3, dtype=bool)

    def after(*signal_db: float, present: Any = both) -> int:
        serving.update(np.array([signal_db]), present, np.ones(1, dtype=bool))
        return int(serving.node[0])

    assert after(-60, -61, -90) == 1
    assert [after(-60, -58, -90) for _ in range(5)] == [1] * 5  # within the hysteresis
    assert [after(-60, -56, -90) for _ in range(2)] == [1, 1]
    assert after(-60, -58, -90) == 1  # not on end
    assert [after(-60, -56, -90) for _ in range(3)] == [1, 1, 2]
    assert serving.handovers == 1
    assert after(-60, -56, -90, present=np.array([True, False, True])) == 1  # at once
    assert after(-60, -56, -90, present=~both) == 0  # the UAV that leads
    assert after(-60, -56, -90) == 2


@BOTH
@pytest.mark.parametrize("access", ["fdma", "tdma"])
def test_one_hash_in_one_process_in_many_and_after_a_kill(
    settings: tuple[str, ...], access: str, tmp_path: Path
) -> None:
    slow = ("radio.coherence_time_s=0.02", "radio.latency_threshold_slots=12", f"radio.access={access}")
    flown = scenario(*settings, *slow, "federation.period=100", LATER, faults=[kill(0, 250)])
    whole, _ = rounds(flown)
    nodes, _ = rounds(flown, uavs_per_node=1)
    assert whole["rounds"] == 3
    but = ("run_id", "wire_bytes", "radio")
    assert steady(nodes, *but) == steady(whole, *but)
    assert nodes["radio"]["links"] == whole["radio"]["links"]
    again = resumed(dead(tmp_path, flown, 210, rows=3), "--uavs-per-process", "4")
    assert again["trajectory_sha256"] == whole["trajectory_sha256"]
    assert again["radio"]["backhaul_bits"] == whole["radio"]["backhaul_bits"]


class Deaf(Channel):
    """A channel that knows UAVs only."""

    name = "deaf"

    def carry(self, memory: Any, message: Any, rng: np.random.Generator) -> Any:
        ones = np.ones(len(message.source), dtype=np.int64)
        return memory, ones, ones > 0


@pytest.mark.parametrize(
    ("settings", "options", "text"),
    [
        (("federation.station=1", MAST), {}, r"`federation.station` is 1, and there are 1 `\[\[stations\]\]`"),
        (("federation.station=0",), {}, r"there are 0 `\[\[stations\]\]`"),
        (("stations=[{place=[0.0, 0.0, -1.0]}]",), {}, r"stations\[0\].place\[2\]: expected a number >= 0"),
        (("stations=[{place=[0.0, 0.0, 1.0], gain_dbi=nan}]",), {}, "gain_dbi"),
        (
            (MAST, "start.positions=[[0.0, 0.0], [9.0, 0.0]]", "uavs=2", "start.height=25.5"),
            {},
            r"`stations\[0\]` stands 0.5 m from the start of UAV 0, at a height of 25.5 m; move it 1 m away",
        ),
        ((MAST,), {"faults": [kill(1, 3)]}, r"`faults\[0\].stations` names station 1"),
        ((MAST,), {"faults": [{"kind": "kill", "tick": 3}]}, "name one at least"),
        (
            ("stations=[{place=[0.0, 0.0, 1.0], tx_power_dbm=30.0}]",),
            {},
            r"the channel rice has one radio for all; remove .* `stations\[0\]`",
        ),
        ((MAST, "radio.model=deaf"), {}, "has a `carry` that knows UAVs only.*stations = True"),
        ((MAST, "federation.topology=stations", "federation.retries=1"), {}, "stations repeat nothing"),
    ],
)
def test_what_stations_cannot_be_is_refused(settings: tuple[str, ...], options: dict[str, Any], text: str) -> None:
    plugins.register(Deaf)
    with pytest.raises((BadInput, ValueError), match=text):
        plan_of(scenario(*settings, **options))


def test_a_topology_that_flies_its_leader_takes_no_station() -> None:
    class Old(plugins.load("topology", "leader")):  # type: ignore[misc]
        name = "old"
        bears_station = False

    plugins.register(Old)
    with pytest.raises(BadInput, match="the topology old has its leader aboard a UAV"):
        plan_of(scenario(MAST, "federation.topology=old"))
