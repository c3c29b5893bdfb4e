"""What a controller can say of its model beside the numbers: ready, based, a note; and what it hears of an arrival."""

import numpy as np
import pytest

from meanflock.agent.controllers.base import Arrival, Controller, Memory, Step
from meanflock.agent.node import Agent
from meanflock.federation.plan import plan_of
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, encode
from meanflock.swarm.wire.messages import Welcome


class Speaker(Controller):
    """Controller whose UAVs of even number have a model."""

    name = "speaker"
    parameters = 2
    note_bytes = 8

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        return {"uav": uavs.astype(np.int64), "model": np.zeros((len(uavs), 2)), "heard": np.zeros((len(uavs), 3))}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: object) -> Step:
        return Step(memory, np.zeros((len(own), 2)))

    def get(self, memory: Memory) -> np.ndarray:
        return memory["model"]

    def ready(self, memory: Memory) -> np.ndarray:
        return memory["uav"] % 2 == 0

    def based(self, memory: Memory) -> np.ndarray:
        return 3 + memory["uav"]

    def note(self, memory: Memory) -> list[bytes]:
        if 4 in memory["uav"]:
            raise ValueError("UAV 4 has none")
        return [b"x" * int(uav) for uav in memory["uav"]]

    def arrived(self, memory: Memory, rows: np.ndarray, arrival: Arrival) -> Memory:
        if not arrival.whole.all() and len(memory["uav"]) > 1:
            raise ValueError("only alone")
        heard, model = memory["heard"].copy(), memory["model"].copy()
        heard[rows] = np.stack(
            [np.full(len(rows), arrival.number), arrival.whole, [len(note) for note in arrival.notes]], axis=1
        )
        model[rows] = arrival.models
        return memory | {"heard": heard, "model": model}


@pytest.fixture
def agent() -> Agent:
    plugins.register(Speaker)
    flown = Scenario(method="speaker", uavs=6)
    starts = np.zeros((6, 4), dtype=np.float32)
    return Agent(Welcome(0, "agent-0", (0, 1, 2, 4), 0, encode(plan_of(flown).node_scenario), starts))


def test_rows_without_a_model_are_not_ready(agent: Agent) -> None:
    assert agent.ready(np.array([0, 1, 3])).tolist() == [0, 3]


def test_training_began_with_a_round(agent: Agent) -> None:
    based = agent.based(np.array([1, 2]))
    assert based is not None
    assert based.tolist() == [4, 5]


def test_a_note_that_fails_silences_its_row_only(agent: Agent) -> None:
    agent._controller.begin(None)
    assert agent.notes(np.array([0, 1, 3])) == [b"", b"x", b""]
    assert agent.silent().tolist() == [False, False, False, True]
    (problem,) = agent.problems
    assert problem.uavs == (4,)
    assert "UAV 4 has none" in problem.failure


def test_an_arrival_has_its_round_and_what_is_missing(agent: Agent) -> None:
    rows, models = np.array([1, 2]), np.array([[1.0, 2.0], [3.0, 4.0]])
    agent.take(rows, models, 7, np.array([True, False]), [b"ab", b""])
    assert agent._memory["heard"][rows].tolist() == [[7, 1, 2], [7, 0, 0]]
    assert agent._memory["model"][rows].tolist() == models.tolist()
    agent.take(rows, models, 0, np.ones(2, dtype=bool), [b"", b""])
    assert agent._memory["heard"][rows].tolist() == [[0, 1, 0]] * 2


def test_a_note_is_limited() -> None:
    class Long(Speaker):
        name = "long-note"
        note_bytes = 70_000

    plugins.register(Long)
    with pytest.raises(BadInput, match="`note_bytes` is 70000"):
        plan_of(Scenario(method="long-note"))
