"""The events of a flight in which much fails are equal in one node, in several, with messages, and resumed.

Those of real processes: tests/integration/test_processes.py.
"""

from collections.abc import Callable
from typing import Any

import pytest

from meanflock.swarm import plugins
from meanflock.swarm.events import AgentFailed, FitFailed, FlightEvent, LeaderTookOver, StatesRefused
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.failures import Reports
from tests.faults.conftest import Lab
from tests.faults.troubled import SETTINGS, Troubled
from tests.telemetry import Record, comparable, fly


@pytest.fixture
def flown() -> Scenario:
    plugins.register(Troubled)
    return load(None, list(SETTINGS), method="troubled")


def with_messages(flown: Scenario, uavs: int) -> Record:
    lab = Lab(flown, uavs_per_node=[*[uavs] * (8 // uavs), 1])
    lab.fly()
    return lab.record


FORMS: dict[str, Callable[[Scenario], Record]] = {
    "3 UAVs a node": lambda flown: fly(flown, rows=3)[1],
    "1 UAV a node": lambda flown: fly(flown, rows=1)[1],
    "2 UAVs a node, with messages": lambda flown: with_messages(flown, 2),
    "1 UAV a node, with messages": lambda flown: with_messages(flown, 1),
}


def failures(events: list[FlightEvent]) -> list[FlightEvent]:
    return [event for event in events if isinstance(event, AgentFailed | FitFailed | StatesRefused | LeaderTookOver)]


def test_one_node_tells_each_failure_once_and_none_of_uavs_that_take_no_part(flown: Scenario) -> None:
    assert [(event.tick, event.text.partition(" (troubled.py")[0]) for event in failures(fly(flown)[1].events)] == [
        (
            12,
            "agent-0: controller 'troubled' failed with UAVs 1, 5: RuntimeError: UAV 1 gives up",
        ),
        (12, "agent-0: controller 'troubled' failed with UAV 2: its acceleration along x is 1e+40"),
        (12, "agent-0: no data for UAV 0"),
        (12, "agent-0: no data for UAV 7"),
        (12, "states of UAV 3 were not believed: no UAV can be so"),
        (14, "leader.2 takes over from leader"),
        (15, "agent-0: no data for UAV 0"),
        (15, "agent-0: no data for UAV 7"),
    ]


@pytest.mark.parametrize("form", FORMS)
def test_events_are_those_of_one_node_in_the_same_order(form: str, flown: Scenario) -> None:
    assert comparable(FORMS[form](flown).events) == comparable(fly(flown)[1].events)


@pytest.mark.parametrize("form", [None, *FORMS])
def test_an_event_has_the_error_of_the_first_uav_that_it_names_and_not_of_one_that_was_lost(
    form: str | None, flown: Scenario
) -> None:
    lost = flown.replace(faults=[{"kind": "kill", "tick": 9, "uavs": [1, 6]}])
    record = FORMS[form](lost) if form else fly(lost)[1]
    failures = [
        event.failure for event in record.events if isinstance(event, AgentFailed) and "gives up" in event.failure
    ]
    assert [failure.partition(" (troubled.py")[0] for failure in failures] == [
        "controller 'troubled' failed with UAV 5: RuntimeError: UAV 5 gives up"
    ]


@pytest.mark.parametrize("form", FORMS)
def test_events_do_not_depend_on_the_order_in_which_reports_come(
    form: str, flown: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    events = FORMS[form](flown).events
    add = Reports.add

    def insert(self: Reports, *report: Any, **options: bool) -> None:
        add(self, *report, **options)
        self._reports.insert(0, self._reports.pop())

    monkeypatch.setattr(Reports, "add", insert)
    assert FORMS[form](flown).events == events


@pytest.mark.parametrize("rows", [None, 1])
@pytest.mark.parametrize("before", [None, 1])
def test_a_resumed_flight_tells_no_failure_again(before: int | None, rows: int | None, flown: Scenario) -> None:
    whole = fly(flown, rows=before)[1]
    (*_, past) = whole.checkpoints
    assert past.tick > 100
    resumed = fly(flown, rows=rows, resume=past)[1].events
    assert comparable(resumed) == comparable(whole.events_from(past.block + 1))
    assert failures(resumed) == []


def test_an_upload_that_several_nodes_refuse_counts_once() -> None:
    keys = ["uavs=6", "duration=8", "federation.period=20", "federation.byzantine_fraction=0.3"]
    flown = load(None, [*keys, "federation.topology=neighbours", "federation.byzantine_kind=huge"])
    refused, *others = [fly(flown, rows=rows)[0]["uploads_refused"] for rows in (None, 1, 4)]
    assert refused > 0
    assert others == [refused, refused]
