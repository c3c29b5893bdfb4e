"""Groups: UAVs of several controllers, vehicles and missions in one flight. Their bits in all modes are golden."""

import re
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.cruise import Cruise
from meanflock.federation.plan import plan_of, plugins_of
from meanflock.federation.schedule import Schedule
from meanflock.launch.engine import Engine
from meanflock.results import quantities
from meanflock.swarm import mission
from meanflock.swarm.events import Lost
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind, LinkColumn, Status
from meanflock.worldsim.crew import LocalCrew, fly
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.tick import Row
from meanflock.worldsim.world import World
from tests.golden.flights import steady
from tests.telemetry import fly as fly_recorded

SIDE_BY_SIDE: dict[str, Any] = {
    "uavs": 8,
    "duration": 12.0,
    "stop": "duration",
    "federation": {"period": 30, "leader": 3},
    "groups": [
        {"name": "couriers", "count": 3, "method": "orca"},
        {"name": "learners", "count": 3},
        {"name": "reserve", "count": 2, "joins_at_s": 4.0, "leaves_at_s": 9.0},
    ],
}


def rows_of(scenario: Scenario) -> list[Row]:
    """The rows of a flight in one process."""
    world = World(plan_of(scenario))
    return [world.begun(), *fly(world, LocalCrew(world))]


def test_groups_of_one_controller_are_one_to_the_bit() -> None:
    whole = Scenario(uavs=9, duration=21.0)
    divided = whole.replace(groups=[{"name": "a", "count": 4}, {"name": "b", "count": 5}])
    assert len(plan_of(divided).groups) == 1
    first, second = (steady(Engine(one, "one").complete()) for one in (whole, divided))
    named = second.pop("groups")
    assert first.pop("groups") is None
    assert named["a"]["arrived"] + named["b"]["arrived"] == first["arrived"]
    assert first.pop("scenario_sha256") != second.pop("scenario_sha256")
    assert first == second


def test_what_every_group_has_of_its_own_need_not_be_installed_for_the_flight() -> None:
    own: dict[str, Any] = {"count": 1, "vehicle": {}, "training": {}}
    groups = [own | {"name": "a", "method": "cruise"}, own | {"name": "b", "method": "lqr"}]
    keys = {"method": "elsewhere", "vehicle": {"model": "elsewhere"}, "training": {"learner": "elsewhere"}}
    flown = Scenario(uavs=2, duration=1.0, groups=groups, **keys)
    wanted = [(kind, name) for kind, name, _ in plugins_of(flown) if kind in ("controller", "vehicle", "learner")]
    assert wanted == [("controller", "cruise"), ("vehicle", "point-mass"), ("controller", "lqr")]
    assert fly_recorded(flown)[1].checkpoints


@pytest.mark.parametrize("kind", ["controller", "vehicle"])
def test_a_uav_flies_as_in_a_flight_of_its_kind_alone(kind: str) -> None:
    """Of controllers that do not hear others, each row is that of a flight in which all UAVs are alike."""
    own = {
        "controller": [{"method": "cruise"}, {"method": "lqr"}],
        "vehicle": [{"vehicle": {"acceleration_max": 1.0}}, {"vehicle": {"model": "multirotor"}}],
    }[kind]
    common: dict[str, Any] = {"uavs": 6, "duration": 5.0, "method": "cruise", "space": {"dimensions": 3}}
    mixed = [{"name": f"group{number}", "count": 3, **keys} for number, keys in enumerate(own)]
    both = rows_of(Scenario(**common, groups=mixed))
    for number, keys in enumerate(own):
        uavs = slice(3 * number, 3 * number + 3)
        for mine, alone in zip(both, rows_of(Scenario(**common | keys)), strict=True):
            np.testing.assert_array_equal(mine.states[uavs], alone.states[uavs])


def test_only_groups_that_share_a_model_take_part_in_rounds() -> None:
    scenario = Scenario(**SIDE_BY_SIDE)
    plan = plan_of(scenario)
    assert plan.scenario.federation.group == ("learners", "reserve")
    assert plan.scenario.members.tolist() == [3, 4, 5, 6, 7]
    assert {len(Schedule(plan).participants(number)) for number in range(1, 9)} == {plan.scenario.participants} == {4}
    links = np.concatenate([row.links for row in rows_of(scenario)])
    models = links[links[:, LinkColumn.KIND] != FrameKind.STATE]
    assert len(models)
    assert models[:, [LinkColumn.SOURCE, LinkColumn.TARGET]].min() == 3
    states = links[links[:, LinkColumn.KIND] == FrameKind.STATE]
    assert set(states[:, LinkColumn.SOURCE].tolist()) == {0, 1, 2}  # only ORCA broadcasts; all in range hear it
    named = plan_of(scenario.replace(**{"federation.group": "learners"}))
    assert named.scenario.members.tolist() == [3, 4, 5]


def test_a_controller_gets_the_broadcasts_that_it_understands() -> None:
    keys = SIDE_BY_SIDE | {"groups": [*SIDE_BY_SIDE["groups"][:2], {"name": "wary", "count": 2, "method": "bvc"}]}
    orca, learners, bvc = plan_of(Scenario(**keys)).groups
    wary = [True] * 3 + [False] * 3 + [True] * 2
    assert [np.asarray(group.hears).tolist() for group in (orca, learners, bvc)] == [
        wary,
        [False] * 3 + [True] * 3 + [False] * 2,
        wary,
    ]


def test_a_group_that_joins_late_waits_and_one_that_leaves_lands() -> None:
    scenario = Scenario(**SIDE_BY_SIDE)
    rows = rows_of(scenario)
    start = mission.starts(scenario)[6:]
    places = np.stack([row.states[6:] for row in rows])
    assert (places[:41] == start).all()
    assert (places[41] != start).any()
    assert (places[91:, :, :2] == places[90, :, :2]).all()
    assert not places[91:, :, 2:].any()
    assert rows[-1].status.tolist() == [Status.FLYING] * 6 + [Status.LANDED] * 2
    texts = [event.text for row in rows for event in row.events]
    assert "UAVs 6, 7 of group reserve joined" in texts
    assert "UAVs 6, 7 landed: group reserve leaves" in texts
    sends = [row.tick for row in rows if 6 in row.links[:, LinkColumn.SOURCE]]
    assert sends
    assert all(40 < tick <= 90 for tick in sends)


@pytest.mark.parametrize("time_s", [1.0, 4.0], ids=["before", "in the tick"])
def test_a_uav_that_is_lost_before_its_group_joins_stays_on_the_ground(time_s: float) -> None:
    killed = {"kind": "kill", "time_s": time_s, "uavs": [7]}
    rows = rows_of(Scenario(**SIDE_BY_SIDE, faults=[killed]))
    places = np.stack([row.states[6:] for row in rows])
    assert (places[:, 1] == places[0, 1]).all()
    assert (places[41, 0] != places[0, 0]).any()
    joined = [event.text for row in rows for event in row.events if event.text.endswith("joined")]
    assert joined == ["UAV 6 of group reserve joined"]


def test_a_uav_that_is_lost_on_the_ground_and_rejoins_takes_off() -> None:
    flight = Flight(Scenario(**SIDE_BY_SIDE))
    flight.lose(np.array([0, 7]), Lost, "its node is gone")
    assert flight.lost_on_ground.tolist() == [False] * 7 + [True]
    flight.rejoin(np.array([0, 7]), "agent-7")
    assert not flight.lost_on_ground.any()


class Discreet(Cruise):
    """Flies like `cruise`; its class says that it shares its states, and its options that it does not."""

    name = "discreet"
    shares = True

    class Options(Cruise.Options, frozen=True):
        """The options of `discreet`."""

        tells: bool = False

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.shares = options.tells


@pytest.mark.parametrize("method", ["cruise", "discreet"])
def test_a_uav_does_not_avoid_the_starts_of_uavs_that_never_say_where_they_are(method: str) -> None:
    mf.register(Discreet)
    places = [[97.5, 58.5], [95.0, 57.0], [92.5, 55.5]]

    def flown(others: list[list[float]]) -> np.ndarray:
        """Of a UAV that shares its states and flies from (100, 60) to (0, 0)."""
        silent = {"name": "silent", "count": 3, "method": method, "start": {"positions": others}}
        courier = {"name": "courier", "count": 1, "method": "orca", "start": {"positions": [[100.0, 60.0]]}}
        rows = rows_of(Scenario(uavs=4, duration=60.0, stop="duration", groups=[silent, courier]))
        return np.stack([row.states[3] for row in rows])

    on_its_way, elsewhere = flown(places), flown([[x, -y] for x, y in places])
    np.testing.assert_array_equal(on_its_way, elsewhere)


@pytest.mark.parametrize(("joining", "hears"), [("orca", True), ("bvc", True), ("cruise", False)])
def test_uavs_that_share_their_states_send_them_when_a_group_that_hears_them_joins(joining: str, hears: bool) -> None:
    early = {"name": "early", "count": 2, "method": "orca", "start": {"positions": [[40.0, 2.0], [40.0, -2.0]]}}
    late = {"name": "late", "count": 2, "method": joining, "joins_at_s": 30.0, "start": {"centre": [-60.0, 0.0]}}
    paused = [{"kind": "pause", "uavs": [1], "time_s": 29.9, "duration_s": 0.3}]
    scenario = Scenario(uavs=4, duration=30.5, stop="duration", groups=[early, late], faults=paused)
    links = np.concatenate([row.links for row in rows_of(scenario) if row.tick > 296])
    sent = links[:, [LinkColumn.TICK, LinkColumn.SOURCE, LinkColumn.TARGET]]
    of_early = sent[sent[:, 1] < 2]  # all predict them to hover, as they do
    first = {(source, target): tick for tick, source, target in of_early[::-1].tolist() if target > 1}
    assert first == ({(0, 2): 300, (0, 3): 300, (1, 2): 302, (1, 3): 302} if hears else {})


@pytest.mark.parametrize("keys", [{"method": "vasarhelyi"}, {"method": "cruise", "filter": {"kind": "ecbf"}}])
@pytest.mark.parametrize("away", [{"joins_at_s": 39.0}, {"leaves_at_s": 0.1}], ids=["waits", "landed"])
def test_a_uav_does_not_avoid_uavs_that_wait_on_the_ground_or_landed(
    away: dict[str, Any], keys: dict[str, Any]
) -> None:
    def flown(place: list[float]) -> np.ndarray:
        """Of a UAV that flies from (−40, 0) to (40, 0), beside one at a place on the ground."""
        courier = {"name": "courier", "count": 1, "start": {"positions": [[-40.0, 0.0]]}}
        goal = {"destination": {"positions": [[40.0, 0.0]]}}
        other = {"name": "other", "count": 1, "start": {"positions": [place]}, **away}
        rows = rows_of(Scenario(uavs=2, duration=40.0, stop="duration", groups=[courier | goal, other], **keys))
        return np.stack([row.states[0] for row in rows])

    np.testing.assert_array_equal(flown([0.5, 0.2]), flown([0.5, 70.0]))


def test_columns_of_the_filter_are_those_of_no_controller() -> None:
    plan = plan_of(Scenario(**SIDE_BY_SIDE, filter={"kind": "ecbf"}))
    couriers, learners = plan.groups
    assert {"infeasible", "unsent"} <= set(couriers.declared.diagnostics) - set(learners.declared.diagnostics)
    assert {"filter_infeasible", "filter_unsent"} <= set(couriers.declared.diagnostics) & set(
        learners.declared.diagnostics
    )
    alike = SIDE_BY_SIDE | {"groups": [group | {"method": "mfgfl-hf"} for group in SIDE_BY_SIDE["groups"]]}
    assert "unsent" in plan_of(Scenario(**alike, filter={"kind": "ecbf"})).declared.diagnostics


def test_the_summary_has_the_fields_of_each_group_and_of_all() -> None:
    summary = Engine(Scenario(**SIDE_BY_SIDE), "groups").complete()
    groups = summary["groups"]
    assert summary["method"] == "orca+mfgfl-hf"
    assert [group["uavs"] for group in groups.values()] == [3, 3, 2]
    assert groups["reserve"]["landed"] == summary["landed"] == 2
    weighted = sum(group["uavs"] * group["energy_mean_J"] for group in groups.values()) / 8
    assert weighted == pytest.approx(summary["energy_mean_J"])
    assert sum(group["airtime_s"] for group in groups.values()) == pytest.approx(summary["radio"]["airtime_s"])
    phi_g = plan_of(Scenario(**SIDE_BY_SIDE)).declared.diagnostics.index("phi_G")
    rows = rows_of(Scenario(**SIDE_BY_SIDE))
    learners = [
        row.diagnostics[3:, phi_g] for row in rows[1:]
    ]  # before a UAV joins, and when it has left, it reports 0
    assert summary["diagnostics_mean"]["phi_G"] == pytest.approx(np.sum(learners) / (3 * 120 + 2 * 50))


def test_figures_of_groups_are_parts_of_those_of_the_flight() -> None:
    """Of one group of all UAVs they are those of the flight; of several, sums or the least."""
    duel = {"duration": 60.0, "method": "cruise", "wind.sigma": 0.5, "federation.period": 30}
    flown = Scenario.load("swap", **duel, obstacles=[{"centre": [10.0, 5.0], "radius": 4.0}])
    n, courier = flown.uavs, {"name": "b", "method": "orca"}
    for counts, second in ([n], {}), ([n - 7, 7], {}), ([n - 7, 7], courier):
        groups = [{"name": name, "count": count} for name, count in zip("ab", counts, strict=False)]
        groups[-1] |= second
        summary = Engine(flown.replace(groups=groups), "parts").complete()
        found = list(summary["groups"].values())
        assert summary["collisions_all"] > 0 < summary["obstacle_hits"]
        assert summary["closest_approach_m"] <= min(group["closest_approach_m"] for group in found)
        for key in ("obstacle_hits", *(f"payload_bits.{kind}" for kind in summary["payload_bits"])):
            assert sum(quantities.number(group, key) for group in found) == quantities.number(summary, key), key
        for name, total in summary["diagnostics"].items():
            assert sum(group["diagnostics"].get(name, 0.0) for group in found) == pytest.approx(total)
        if len(found) == 1:
            (whole,) = found
            assert whole["phi_A"] == pytest.approx(summary["phi_A"])
            assert whole["closest_approach_m"] == summary["closest_approach_m"]
            for key in ("collisions", "collisions_all", "arrived", "control_effort", "bits_to_arrival"):
                assert whole[key] == summary[key], key


def test_a_group_is_billed_until_its_own_last_arrival() -> None:
    near = {"start": {"formation": "circle", "centre": [15.0, 0.0], "radius": 3.0}, "method": "orca"}
    groups = [{"name": "near", "count": 3, **near}, {"name": "far", "count": 3}]
    keys = {"uavs": 6, "duration": 30.0, "stop": "duration", "method": "orca", "sharing": {"policy": "tick"}}
    groups = Engine(Scenario(**keys, groups=groups), "billed").complete()["groups"]
    assert groups["near"]["arrived"] == 3
    assert groups["far"]["arrived"] == 0
    each = groups["near"]["payload_bits"]["total"] / 301  # in each tick, and the plan
    assert groups["near"]["bits_to_arrival"]["total"] == pytest.approx(each * (1 + 10 * groups["near"]["t_max_s"]))
    assert groups["far"]["bits_to_arrival"] == groups["far"]["payload_bits"]


def test_several_nodes_and_threads_fly_the_same_bits() -> None:
    scenario = Scenario(**SIDE_BY_SIDE)
    alone = steady(Engine(scenario, "one").complete())
    assert steady(Engine(scenario, "some", uavs_per_node=2).complete()) == alone
    assert steady(Engine(scenario, "threads", threads=3).complete()) == alone


RING = {"formation": "circle"}
TRACE = {"model": "trace", "options": {"file": "x.csv"}}
A, B = {"name": "a", "count": 2}, {"name": "b", "count": 3}
BAD: list[tuple[dict[str, Any], str]] = [
    ({"groups": [A]}, "`groups` have 2 UAVs in all, and `uavs` is 5; set `uavs` to 2"),
    ({"groups": [A, B | {"count": 2**31}]}, "lower a `count`, because `uavs` is 2147483647 at most"),
    ({"groups": [A, B | {"name": "a"}]}, "two `groups` have the name 'a'"),
    ({"groups": [A, B | {"name": "no name"}]}, "name"),
    ({"groups": [A, B | {"count": 0}]}, "count"),
    ({"groups": [A, B | {"joins_at_s": 300.0}]}, "`groups[1].joins_at_s` is 300 s, and the flight ends at `duration`"),
    ({"groups": [A, B | {"joins_at_s": 9.0, "leaves_at_s": 9.0}]}, "let it leave at least a tick"),
    ({"groups": [A, B | {"joins_at_s": 5.01, "leaves_at_s": 5.04}]}, "let it leave at least a tick, `dt` 0.1 s, later"),
    (
        {"groups": [A, B | {"joins_at_s": 9.99}], "duration": 10.0},
        "`groups[1].joins_at_s` is 9.99 s, and the flight ends",
    ),
    ({"groups": [A, B | {"start": {"height": 50.0}}]}, "in the plane all fly at `start.height`, 40 m"),
    ({"groups": [A, B | {"start": {"positions": [[0.0, 0.0]]}}]}, "`groups[1]`: `start.positions` has 1 places"),
    ({"groups": [A | {"start": RING}, B | {"start": RING}]}, "UAV 0 and UAV 2 start 0 m apart"),
    ({"groups": [A, B | {"destination": {"goals": "across"}}]}, '`groups[1]`: `destination.goals` "across" needs'),
    ({"groups": [A, B], "federation": {"group": "c"}}, "`federation.group` names 'c', and the groups are a, b"),
    ({"groups": [A, B], "federation": {"group": []}}, "`federation.group` is an empty list"),
    ({"groups": [A, B], "federation": {"group": ["a", "a"]}}, "`federation.group` names 'a' twice"),
    ({"federation": {"group": "c"}}, "there are no `[[groups]]`"),
    ({"groups": [A, B], "radio": {"model": "link-budget"}, "radios": [{"group": "c", "gain_dbi": 1.0}]}, "names 'c'"),
    ({"groups": [A, B], "radios": [{"group": "a", "uavs": [1], "gain_dbi": 1.0}]}, "set one of the two"),
    ({"groups": [A | {"method": "nobody"}, B]}, "group 'a': .*nobody"),
    ({"groups": [A, B | {"method": "cruise"}], "federation": {"group": "b"}}, "shares no model"),
    ({"groups": [A, B | {"method": "mfgfl-h"}]}, "groups 'a' and 'b' share models of"),
    (
        {"groups": [A | {"method": "cruise"}, B]},
        "UAV 0, which takes no part in rounds; set `federation.leader=2`, or another of UAVs 2…4",
    ),
    ({"groups": [A, B | {"method": "cruise"}], "federation": {"clusters": 2}}, "clusters needs all UAVs"),
    ({"groups": [A, B | {"vehicle": {"model": "balloon"}}]}, "group 'b': vehicle 'balloon' is not installed here"),
    ({"groups": [A, B | {"vehicle": {"options": {"x": 3}}}]}, "group 'b': vehicle.options: there is no key `x`"),
    ({"groups": [A, B | {"vehicle": TRACE}]}, "group 'b': trace x.csv: No such file"),
    (
        {"groups": [A, B | {"vehicle": {}}], "vehicle": TRACE},
        "group 'b' has a vehicle of its own; leave out one of them",
    ),
]


@pytest.mark.parametrize(("keys", "text"), BAD, ids=[text[:40] for _, text in BAD])
def test_groups_that_contradict_each_other_are_refused(keys: dict[str, Any], text: str) -> None:
    pattern = text if ".*" in text else re.escape(text)
    with pytest.raises(mf.BadInput, match=pattern):
        plan_of(Scenario(uavs=5, **keys))


def test_flights_that_are_commanded_from_outside_have_no_groups() -> None:
    with pytest.raises(mf.BadInput, match=r"take one without them"):
        mf.Stepped("groups")
