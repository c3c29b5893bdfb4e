"""Channels as plug-ins: one of a user carries frames; shadows of the example keep their correlation and resume."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.channel.base import Channel, Message
from meanflock.channel.medium import Medium
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.channel.frames import line
from tests.faults.dying import dead, resumed
from tests.golden.flights import steady


class Disk(Channel):
    """Everything gets through within a radius, in one slot; beyond it nothing does, in two."""

    name = "disk"

    def transmit(self, distance_m: Any, bits: int, rng: np.random.Generator) -> tuple[Any, Any]:
        near = distance_m <= 2.5
        return np.where(near, 1, 2), near


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, ["uavs=5", *settings], **options)


def test_a_channel_of_a_user_carries_frames_without_a_closed_form() -> None:
    plugins.register(Disk)
    medium = Medium(scenario("radio.model=disk"))
    sent = [Frames(FrameKind.STATE, 0, np.arange(5, dtype=np.int32), np.ones((5, 4), dtype=np.float32))]
    records = medium.send(3, sent, line(0, 2, 4, 6, 50))
    (batch,) = medium.due(4)
    near = [(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2)]
    assert [(int(s), int(t)) for s, t in batch.links] == near
    assert [(int(s), int(t)) for _, s, t, _, slots in records if slots > 0] == near
    assert set(np.abs(records[:, 4]).tolist()) == {1, 2}
    total = medium.meter.traffic[FrameKind.STATE]
    assert (total.sent, total.delivered, total.slots, total.delivered_slots) == (20, 6, 6 + 2 * 14, 6)
    assert (total.expected_outages, total.expected_delivered_slots) == (None, None)
    again = Medium(scenario("radio.model=disk"))
    again.restore(medium.snapshot())
    assert again.meter.traffic == medium.meter.traffic


@pytest.mark.parametrize(("model", "unknown"), [("disk", True), ("ideal", False), ("rice", False)])
def test_a_summary_has_the_closed_forms_there_are(model: str, unknown: bool) -> None:
    plugins.register(Disk)
    radio = Engine(scenario(f"radio.model={model}", "duration=2", method="hjb"), "forms").complete()["radio"]
    assert radio["sent"] > 0
    for name in ("outage_rate_theory", "latency_slots_mean_theory"):
        assert (radio[name] is None) == (radio["traffic"]["state"][name] is None) == unknown
    if model == "ideal":
        assert (radio["outages"], radio["outage_rate_theory"]) == (0, 0.0)
        assert radio["latency_slots_mean"] == radio["latency_slots_mean_theory"] == 1.0


EXAMPLE = Path(__file__).parents[2] / "examples" / "shadowing.py"
SETTINGS = ["method=vasarhelyi", "uavs=5", "radio.model=shadowing", "radio.options={reach_m=4}", "duration=30"]


@pytest.fixture
def shadowing() -> Any:
    """The class of the example, installed."""
    (found,) = plugins.load_file(EXAMPLE)
    return plugins.load(found.kind, found.name)


def test_shadows_keep_the_correlation_of_their_way_and_their_variance(shadowing: Any) -> None:
    uavs, way_m = 200, 5.0
    source, target = np.triu_indices(uavs, 1)
    channel = shadowing(shadowing.Options(sigma_db=6.0, correlation_m=20.0), Scenario())
    rng, memory = np.random.default_rng(3), channel.init(uavs)
    carried = []
    for tick in range(5):  # all fly 5 m a tick, and in one tick nothing is sent
        if tick != 2:
            place = np.full((uavs, 2), [way_m * tick, 0.0])
            message = Message(tick, 128, source, target, np.full(len(source), 50.0), place)
            memory, _, arrives = channel.carry(memory, message, rng)
            carried.append((tick, memory["shadow_db"][source, target], arrives))
    for tick, shadow_db, arrives in carried:
        assert shadow_db.std() == pytest.approx(6.0, rel=0.02)
        assert np.array_equal(arrives, shadow_db > 0.0)  # at the reach the path loss is zero
        both_m = 2.0 * way_m * tick
        correlation = np.corrcoef(carried[0][1], shadow_db)[0, 1]
        assert correlation == pytest.approx(np.exp(-both_m / 20.0), abs=0.02)


def test_both_directions_and_all_fragments_share_a_shadow(shadowing: Any) -> None:
    channel = shadowing(shadowing.Options(), Scenario())
    ends = np.array([[0, 0, 1, 1], [1, 1, 0, 0]])
    message = Message(0, 128, *ends, np.full(4, 50.0), np.zeros((2, 2)))
    for seed in range(20):
        memory, _, arrives = channel.carry(channel.init(2), message, np.random.default_rng(seed))
        assert len(set(arrives.tolist())) == 1
        assert np.count_nonzero(memory["shadow_db"]) == 1


def test_a_flight_over_shadows_is_the_same_in_nodes_and_after_a_resume(shadowing: Any, tmp_path: Path) -> None:
    flown = load(None, SETTINGS)
    whole = Engine(flown, "whole").complete()
    assert whole["radio"]["outages"] > 0
    assert steady(Engine(flown, "nodes", uavs_per_node=1).complete()) == steady(whole)
    folder = dead(tmp_path, flown, 287, rows=2)
    assert resumed(folder, "--uavs-per-process", "4")["trajectory_sha256"] == whole["trajectory_sha256"]
