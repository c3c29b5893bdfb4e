"""Rows of large swarms in threads of a process: the same bits and events with any number of them."""

import multiprocessing
from pathlib import Path
from typing import Any

import pytest

from meanflock.launch.engine import Engine
from meanflock.swarm import threads, workers
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim import crew
from tests.golden.flights import steady

FLIGHTS: list[dict[str, Any]] = [
    {"method": "mfgfl-hf", "faults": [{"kind": "pause", "time_s": 1.0, "uavs": [2, 5], "duration_s": 1.0}]},
    {"method": "hjb"},
    {"method": "orca", "filter": {"kind": "ecbf"}},
    {"method": "fed-lspi", "federation": {"topology": "neighbours"}},
    {"method": "mfgfl-hf", "space": {"dimensions": 3}},
]


class Events:
    """Sink with the events of a flight."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def write(self, block: Any) -> None:
        self.texts += [event.text for event in block.events]


@pytest.mark.parametrize("keys", FLIGHTS, ids=lambda keys: keys["method"])
def test_a_flight_has_the_same_bits_and_events_with_any_number_of_threads(keys: dict[str, Any]) -> None:
    found = []
    for number in (1, 2, 3, 64):
        events = Events()
        engine = Engine(Scenario(uavs=11, duration=30.0, **keys), "threads", threads=number, sinks=[events])
        assert len(engine.crew.agents) == min(number, 11) or number == 3
        found.append((steady(engine.complete()), events.texts))
    assert all(one == found[0] for one in found)


def test_nodes_are_cut_into_parts_and_keep_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as there are cores, if there are many UAVs and the process has the cores for itself."""
    monkeypatch.setattr(crew, "MANY_UAVS", 10)
    monkeypatch.setattr(crew, "free_cores", lambda: 3)
    scenario = Scenario(uavs=10, duration=1.0)
    assert [len(agent.uavs) for agent in Engine(scenario, "one").crew.agents] == [4, 4, 2]
    whole = Engine(scenario, "some", uavs_per_node=4)
    assert [agent.uavs.tolist() for agent in whole.crew.agents] == [[0, 1], [2, 3], [4, 5], [6, 7], [8, 9]]
    assert whole.crew._nodes == ["agent-0", "agent-0", "agent-4", "agent-4", "agent-8"]
    assert len(Engine(Scenario(uavs=9, duration=1.0), "few").crew.agents) == 1


def test_results_come_in_order_and_the_first_failure_is_raised() -> None:
    assert workers.each(lambda number: number * number, range(50)) == [number * number for number in range(50)]
    with pytest.raises(ZeroDivisionError):
        workers.each(lambda number: 1 // number, [1, 0, 2])


def test_libraries_use_one_thread_in_each_thread() -> None:
    assert workers.each(lambda _: len(threads._own.scope.limits), range(4)) == [1, 1, 1, 1]
    assert workers.each(lambda _: threads._own.scope.limits[0].number, range(1)) == [1]


def test_a_forked_process_has_threads_of_its_own_and_one_core() -> None:
    workers.each(abs, [1, 2])
    with multiprocessing.get_context("fork").Pool(1) as forked:
        assert forked.apply(_in_a_fork) == ([1, 2], 1)
    assert workers.free_cores() == workers.cores()


def _in_a_fork() -> tuple[list[int], int]:
    return workers.each(abs, [-1, 2]), workers.free_cores()


@pytest.mark.parametrize(
    ("limit", "cores"), [("150000 100000", 2), ("50000 100000", 1), ("max 100000", None), ("", None)]
)
def test_the_cores_of_a_container_bound_the_processes(limit: str, cores: int | None, tmp_path: Path) -> None:
    (tmp_path / "cpu.max").write_text(limit)
    bound = workers.cores(tmp_path / "nowhere")
    assert workers.cores(tmp_path) == (bound if cores is None else min(cores, bound))
