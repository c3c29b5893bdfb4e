"""A head, a leader or a whole run that is lost between the two hops of a round."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.federation.schedule import Schedule
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.resume import back
from meanflock.swarm.net.client import NodeClient
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.faults.clusters import CLEAR, PERIOD, SLOW, swarm
from tests.faults.conftest import Lab
from tests.faults.dying import LATER, dead, flight, resumed, steady


def voids(lab: Lab) -> list[tuple[int, str]]:
    return [(event.tick, event.text) for event in lab.record.events if event.kind == "void"]


def without(head: int, number: int, why: str) -> tuple[int, str]:
    return number * PERIOD + 1, f"round {number} goes on without the cluster of UAV {head}: {why}"


def test_a_head_that_is_paused_a_head_that_is_killed_and_a_relay_nobody_can_hear_each_cost_their_cluster() -> None:
    script = """faults=[{kind="pause", tick=41, duration_s=0.1, uavs=[4]}, {kind="kill", tick=61, uavs=[8]},
        {kind="partition", tick=81, duration_s=0.1, uavs=[4]}]""".replace("\n", " ")
    lab = Lab(swarm(script, "federation.fraction=1.0", *CLEAR), uavs_per_node=1)
    summary = lab.fly()
    # Who sleeps when uploads come has not heard them; who dies is silent ever after.
    assert voids(lab) == [
        without(4, 2, "its head is silent"),
        without(8, 3, "its head is silent"),
        without(4, 4, "its relay is lost"),
        without(8, 4, "its head is silent"),
        without(8, 5, "its head is silent"),
    ]
    assert summary["rounds"] == 5
    relays = np.concatenate([block.links for block in lab.record.blocks])
    relays = relays[relays[:, 3] == FrameKind.RELAY]
    told = [(int(tick), int(source), bool(slots > 0)) for tick, source, _, _, slots in relays]
    assert told == [(21, 4, True), (21, 8, True), (41, 8, True), (61, 4, True), (81, 4, False), (101, 4, True)]


def test_a_head_that_falls_silent_between_the_hops_costs_its_cluster_and_the_log_says_so() -> None:
    slow = ("radio.coherence_time_s=0.03", "radio.target_snr_db=60")
    lab = Lab(swarm(*slow, "federation.fraction=1.0"), uavs_per_node=1)
    summary = lab.fly({42: lambda: lab.kill("agent-4")})
    assert voids(lab)[0] == (43, "round 2 goes on without the cluster of UAV 4: its head is silent")
    assert summary["rounds"] == 5


def test_a_node_that_takes_a_head_over_between_the_hops_hears_what_its_predecessor_had_heard() -> None:
    slow = ("radio.coherence_time_s=0.03", "radio.target_snr_db=60", "federation.fraction=1.0")
    lab = Lab(swarm(*slow), uavs_per_node=1)
    undisturbed = lab.fly()
    assert voids(lab) == []
    other = Lab(swarm(*slow), uavs_per_node=1)
    sent: list[Frames] = []
    send = other.world.air.send

    def listen(tick: int, frames: list[Frames], *rest: Any) -> Any:
        sent.extend(batch for batch in frames if batch.kind == FrameKind.RELAY)
        return send(tick, frames, *rest)

    other.world.air.send = listen  # type: ignore[method-assign, assignment]

    def again() -> NodeClient:
        other.kill("agent-4")
        return other.agent()

    rounds = Schedule(other.world._scenario)
    assert rounds.number(rounds.hops[1], 43) == 2
    summary = other.fly({42: again})
    assert voids(other) == []
    counts = {
        (batch.round, uav): row[-1] for batch in sent for uav, row in zip(batch.source, batch.payload, strict=True)
    }
    assert counts[2, 4] == counts[1, 4] == 4  # its own upload among them, sent before it died
    assert summary["rounds"] == undisturbed["rounds"]


@pytest.mark.parametrize("at", [41, 42, 43, 44, 45, 46])
def test_another_leader_takes_over_between_the_hops(at: int) -> None:
    expected = Lab(swarm(*SLOW), leaders=2).fly()
    lab = Lab(swarm(*SLOW), leaders=2)
    summary = lab.fly({at: lambda: lab.kill("leader")})
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]
    assert summary["rounds"] == expected["rounds"]


@pytest.fixture(scope="module")
def rounds_of_ticks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scenario, dict[str, Any]]:
    """Uploads take up to four ticks from tick 20 on, relays up to four more; and the summary if nobody dies."""
    slow = ("radio.coherence_time_s=0.05", "radio.target_snr_db=76")
    of = load(None, ["uavs=9", "federation.clusters=3", LATER, 'stop="duration"', "federation.period=20", *slow])
    return of, flight(tmp_path_factory.mktemp("whole"), of)


@pytest.mark.parametrize("at", range(20, 30))
def test_a_run_resumed_at_any_tick_of_a_round_ends_as_it_would_have(
    at: int, rounds_of_ticks: tuple[Scenario, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of, expected = rounds_of_ticks
    monkeypatch.setattr("meanflock.worldsim.world.REPORT_EVERY_TICKS", 1)
    init = Engine.__init__

    def often(engine: Engine, *given_: Any, **named: Any) -> None:
        init(engine, *given_, **named)
        engine.world._checkpoint_every = 1

    monkeypatch.setattr(Engine, "__init__", often)
    folder = dead(tmp_path / "dead", of, at + 1, rows=4)
    monkeypatch.undo()
    assert back(folder).start.tick == at
    got = resumed(folder, "--uavs-per-process", "2")
    volatile = ("wire_bytes", "radio", "weight_spread_final")
    assert steady(got, *volatile) == steady(expected, *volatile)
    assert got["radio"]["outages"] == expected["radio"]["outages"] > 0
