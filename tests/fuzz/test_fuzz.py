"""Mutated messages, thrown at every receiver in mid-flight: only counted drops. `make fuzz` throws a million.

And random scenarios, which fly alike in every form.
"""

import pytest

from tests.fuzz import scenarios
from tests.fuzz.siege import Insider, Siege

COUNT = 5000


def test_a_flight_under_fire_ends_as_the_one_in_peace() -> None:
    siege = Siege(COUNT, seed=1, clusters=3)
    summary = siege.fly()
    for name in ("trajectory_sha256", "rounds", "arrived", "lost", "collisions", "payload_bits", "radio", "wire_bytes"):
        assert summary[name] == siege.expected[name], name
    assert siege.expected["dropped_messages"] == {}
    assert sum(summary["dropped_messages"].values()) > COUNT / 4
    assert siege.thrown["codec"] >= COUNT
    assert all(siege.thrown[who] > COUNT / 20 for who in ("world", "agent", "leader", "station"))
    for reason in ("malformed", "wrong-shape", "non-finite"):
        assert siege.outcome[f"codec: {reason}"] > 0
    assert {"wrong-kind", "wrong-run", "stale", "unknown-node", "wrong-shape"} <= set(summary["dropped_messages"])


@pytest.mark.parametrize(("who", "clusters"), [("agent-0", 1), ("leader", 1), ("agent-4", 3)])
def test_a_node_gone_mad_ends_neither_the_flight_nor_what_is_told_of_it(who: str, clusters: int) -> None:
    insider = Insider(1000, seed=2, who=who, clusters=clusters)
    summary = insider.fly()
    assert summary["ticks"] == 125
    assert insider.let_in > 0
    assert summary["nodes_lost"] == 0


@pytest.mark.parametrize("first", range(0, 90, 30))
def test_random_scenarios_fly_alike_in_every_form(first: int) -> None:
    assert list(scenarios.broken(range(first, first + 30))) == []
