"""A topology of a user flies like the built-in ones: a ring in which averages go from each UAV to the next."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation import coding
from meanflock.federation.topology.base import Hop, Topology
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.plugins import registry
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind
from tests.faults.dying import dead, flight, resumed, steady

UAVS = 9


class Ring(Topology):
    """Participants upload to the next UAV and to themselves; averages go one UAV further and replace models there."""

    name = "test-ring"

    def hops(self) -> tuple[Hop, ...]:
        scenario, uavs = self.scenario, self.scenario.uavs
        if uavs < 3:
            raise ValueError(f"`federation.topology` is {self.name}, but `uavs` is {uavs}; a ring has three or more")
        everyone = np.arange(uavs)
        following = np.sort(np.stack([everyone, (everyone + 1) % uavs], axis=-1), axis=-1)
        counted = coding.Counted(scenario.radio_payload, scenario.declared.parameters, np.full(uavs, 4))
        upload = Hop(FrameKind.UPLOAD, 0, "agent", everyone, following, coding.of_uploads(scenario))
        relay = Hop(FrameKind.RELAY, scenario.hop_ticks, "agent", everyone, following, counted, mail=upload)
        model = Hop(
            FrameKind.GLOBAL,
            2 * scenario.hop_ticks,
            "agent",
            everyone,
            everyone[:, None],
            coding.of_broadcasts(scenario),
            mail=relay,
            is_last=True,
        )
        return upload, relay, model


@pytest.fixture(autouse=True)
def ring() -> Iterator[None]:
    mf.register(Ring)
    yield
    del registry.registered["topology", Ring.name]


def scenario(*settings: str) -> Scenario:
    fixed = [f"uavs={UAVS}", f"federation.topology={Ring.name}", "federation.period=20", "duration=35"]
    return load(None, [*fixed, 'stop="duration"', *settings], method="mfgfl-h", seed=5)


def test_a_ring_flies_the_same_in_any_number_of_nodes_and_needs_no_leader() -> None:
    engines = [Engine(scenario("federation.payload=int8"), "ring", uavs_per_node=rows) for rows in (None, 1, 4)]
    assert all(member.role == "agent" for engine in engines for member in engine.world.members.present)
    summaries = [engine.complete() for engine in engines]
    for name in ("trajectory_sha256", "rounds", "rounds_void", "payload_bits", "weight_spread_final"):
        assert summaries[0][name] == summaries[1][name] == summaries[2][name]
    assert (summaries[0]["rounds"], summaries[0]["dropped_messages"]) == (17, {})


def test_a_ring_is_billed_by_the_hop_and_no_uav_pays_for_its_own_model() -> None:
    summary = Engine(scenario("federation.fraction=1.0", "radio.target_snr_db=60"), "ring").complete()
    traffic: dict[str, Any] = summary["radio"]["traffic"]
    assert traffic["uplink"]["transmissions"] == traffic["uplink"]["delivered"] == 17 * UAVS
    assert traffic["relay"]["payload_bits"] == 17 * UAVS * (108 + 1) * 32
    assert traffic["broadcast"]["sent"] == 0


def test_a_ring_that_died_in_a_round_resumes_to_the_same_bits(tmp_path: Path) -> None:
    slow = scenario("radio.coherence_time_s=0.1", "radio.latency_threshold_slots=5", "radio.target_snr_db=76")
    whole = flight(tmp_path / "whole", slow)
    folder = dead(tmp_path / "dies", slow, at=145)  # the last checkpoint is of tick 101, in the fifth round
    assert steady(resumed(folder)) == steady(whole)


def test_a_scenario_without_room_for_its_topology_is_refused() -> None:
    with pytest.raises(mf.BadInput, match="a ring has three or more"):
        scenario("uavs=2")
    with pytest.raises(mf.BadInput, match="did you mean"):
        scenario("federation.topology=test-rink")
