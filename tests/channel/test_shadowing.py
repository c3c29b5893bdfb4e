"""Channels with a memory: the example's shadows have the correlation of their closed form, and resume with a flight."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.channel.base import Channel, Message
from meanflock.channel.medium import Medium
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import Scenario, load
from meanflock.testing import check_channel
from tests.faults.dying import dead, resumed
from tests.golden.flights import steady

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
    heard = []
    for tick in range(5):  # all fly 5 m a tick, and in one tick nothing is sent
        if tick != 2:
            place = np.full((uavs, 2), [way_m * tick, 0.0])
            message = Message(tick, 128, source, target, np.full(len(source), 50.0), place)
            memory, _, arrives = channel.carry(memory, message, rng)
            heard.append((tick, memory["shadow_db"][source, target], arrives))
    for tick, shadow_db, arrives in heard:
        assert shadow_db.std() == pytest.approx(6.0, rel=0.02)
        assert np.array_equal(arrives, shadow_db > 0.0)  # at the reach the path loss is zero
        both_m = 2.0 * way_m * tick
        correlation = np.corrcoef(heard[0][1], shadow_db)[0, 1]
        assert correlation == pytest.approx(np.exp(-both_m / 20.0), abs=0.02)


def test_both_directions_and_all_fragments_share_a_shadow(shadowing: Any) -> None:
    channel = shadowing(shadowing.Options(), Scenario())
    ends = np.array([[0, 0, 1, 1], [1, 1, 0, 0]])
    message = Message(0, 128, *ends, np.full(4, 50.0), np.zeros((2, 2)))
    for seed in range(20):
        memory, _, arrives = channel.carry(channel.init(2), message, np.random.default_rng(seed))
        assert len(set(arrives.tolist())) == 1
        assert np.count_nonzero(memory["shadow_db"]) == 1


def test_the_example_conforms(shadowing: Any) -> None:
    check_channel(shadowing)


def test_a_flight_over_shadows_is_the_same_in_nodes_and_after_a_resume(shadowing: Any, tmp_path: Path) -> None:
    flown = load(None, SETTINGS)
    whole = Engine(flown, "whole").complete()
    assert whole["radio"]["outages"] > 0
    assert steady(Engine(flown, "nodes", uavs_per_node=1).complete()) == steady(whole)
    folder = dead(tmp_path, flown, 287, rows=2)
    assert resumed(folder, "--uavs-per-process", "4")["trajectory_sha256"] == whole["trajectory_sha256"]


class Wrong(Channel):
    """A channel whose mistakes are set by the tests."""

    name = "wrong"
    begun: Any = staticmethod(lambda uavs: {"last": np.zeros(uavs)})
    after: Any = staticmethod(
        lambda memory, links: (memory, np.ones(links, dtype=np.int64), np.ones(links, dtype=bool))
    )

    def init(self, uavs: int) -> Any:
        return self.begun(uavs)

    def carry(self, memory: Any, message: Message, rng: np.random.Generator) -> Any:
        return self.after(memory, len(message.source))


def wrong(**changed: Any) -> type:
    return type("Wrong", (Wrong,), {name: staticmethod(change) for name, change in changed.items()})


@pytest.mark.parametrize(
    ("begun", "expected"),
    [
        (lambda uavs: [uavs], "memory is a list; expected a dict"),
        (lambda uavs: {"last": [0.0]}, "a checkpoint keeps"),
        (
            lambda uavs: {"pairs": np.zeros((uavs, 10**8))},
            "MiB for 5 UAVs; a checkpoint keeps up to 256 MiB",
        ),
        (lambda uavs: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_a_wrong_memory_is_refused_before_take_off(begun: Any, expected: str) -> None:
    plugins.register(wrong(begun=begun))
    with pytest.raises(BadInput, match=f"channel 'wrong': .*{expected}"):
        Medium(load(None, ["uavs=5", "radio.model=wrong"]))


def _write(memory: Any, links: int) -> Any:
    memory["last"][:] = 1.0


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        (lambda memory, links: memory, "`carry` returns a dict; expected memory, slots and delivered"),
        (lambda memory, links: ({}, *Wrong.after(memory, links)[1:]), r"memory has \[\]; of `init` it had \['last'\]"),
        (lambda memory, links: ({"last": np.zeros(1)}, *Wrong.after(memory, links)[1:]), r"\(1,\) float64"),
        (_write, "read-only"),
    ],
)
def test_a_wrong_memory_in_flight_ends_the_run_with_its_mistake(after: Any, expected: str) -> None:
    plugins.register(wrong(after=after))
    engine = Engine(load(None, ["uavs=5", "radio.model=wrong", "duration=2", "method=hjb"]), "wrong")
    with pytest.raises(RunFailed, match=f"channel 'wrong': .*{expected}"):
        engine.complete()


def test_a_checkpoint_with_another_memory_is_refused() -> None:
    plugins.register(Wrong)
    medium = Medium(load(None, ["uavs=5", "radio.model=wrong"]))
    with pytest.raises(ValueError, match=r"channel 'wrong': memory\['last'\] is \(4,\) float64"):
        medium.restore(medium.snapshot() | {"memory": {"last": np.zeros(4)}})
