"""The memory of a controller in a checkpoint: only that controller goes on with it."""

import numpy as np
import pytest

from meanflock.agent import node
from meanflock.groundstation.launch import engine
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins import registry
from tests.agent.strangers import Honest, flown, wrong
from tests.telemetry import fly


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_checkpoint_every", lambda *_: 10)


def test_a_checkpoint_of_another_version_of_the_plugin_is_refused_by_name() -> None:
    of = flown(Honest, "duration=3")
    past = fly(of)[1].checkpoints[-1]
    plugin, made = registry.registered["controller", "stranger"]
    registry.registered["controller", "stranger"] = plugin._replace(fingerprint="sha256 of another file"), made
    with pytest.raises(BadInput, match=r"controller 'stranger' of this process; here it is of sha256 of another"):
        Engine(of, "strangers", resume=past)


def test_a_checkpoint_whose_arrays_are_not_those_of_the_plugin_is_refused_with_the_uavs() -> None:
    past = fly(flown(Honest, "duration=3"))[1].checkpoints[-1]
    other = wrong(init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"more": np.zeros(len(uavs))})
    with pytest.raises(BadInput, match=r"UAV 0, 1, 2, 3, 4.* does not fit this controller: .*'more'"):
        Engine(flown(other, "duration=3"), "strangers", resume=past)


def test_a_memory_too_large_for_a_checkpoint_is_not_stored_and_the_flight_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(node, "MAX_MEMORY_BYTES", 2**20)
    large = wrong(init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"map": np.zeros((len(uavs), 100_000))})
    for rows in (None, 1):
        summary, sink = fly(flown(large, "duration=1"), rows=rows)
        assert not any(block.checkpoint for block in sink.blocks)
        assert (summary["ticks"], summary["lost"], summary["dropped_messages"]) == (10, 0, {})
