"""Table of kills: role × signal × phase of a round → outcome. Of real processes: test_killed_processes.py."""

import itertools
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.plan import plan_of
from meanflock.federation.schedule import Schedule
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Act, Sense, Status
from tests.faults.clusters import CLEAR, PERIOD, SLOW, swarm
from tests.faults.conftest import Lab, scenario

TICKS, ROUNDS = 90, 4  # of every flight; the rounds open in ticks 20, 40, 60 and 80
CLUSTERS, HEAD = 2, "agent-3"
# Round 2 on the slow radio. A hop takes three ticks: the heads relay in tick 43, and their leader averages in 46.
PHASES = {
    "between two rounds": 35,
    "as a round opens": 40,
    "as uploads arrive": 42,
    "as heads or the leader average": 43,
    "as the leader of heads averages": 46,
}
LATER = 10  # ticks after which another node comes

SIGNALS: dict[str, Callable[[Lab, str], None]] = {
    "killed": Lab.kill,
    "killed while it is asked": Lab.kill_when_asked,
    "killed after its reply": lambda lab, name: lab.kill_when_asked(name, replies=True),
    "frozen": Lab.freeze,
}


class Role(NamedTuple):
    """A node that is hurt, and the nodes that can take its place."""

    node: str
    leaders: int = 1
    clusters: int = 1
    heir: bool = False  # another node of the role joins `LATER` ticks after a kill
    second: str = ""  # a node that is killed one round later


ROLES = {
    "agent": Role("agent-5"),
    "agent with an heir": Role("agent-5", heir=True),
    "head of a cluster": Role(HEAD, clusters=CLUSTERS),
    "head with an heir": Role(HEAD, clusters=CLUSTERS, heir=True),
    "only leader": Role("leader"),
    "only leader with an heir": Role("leader", heir=True),
    "leader with a standby": Role("leader", leaders=2),
    "leader with two standbys": Role("leader", leaders=3, second="leader.2"),
    "leader of heads with a standby": Role("leader", leaders=2, clusters=CLUSTERS),
}
TABLE = [
    pytest.param(ROLES[role], SIGNALS[signal], tick, id=f"{role}-{signal}-{phase}")
    for role, signal, (phase, tick) in itertools.product(ROLES, SIGNALS, PHASES.items())
    if signal == "killed" or not ROLES[role].heir
]


def flown(clusters: int) -> Scenario:
    return swarm(*SLOW, "federation.fraction=1.0", f"duration={TICKS / 10}", uavs=6, clusters=clusters)


@cache
def undisturbed(clusters: int) -> dict[str, Any]:
    return Lab(flown(clusters)).fly()


@pytest.mark.parametrize(("role", "hurt", "tick"), TABLE)
def test_a_node_that_is_hurt_costs_what_the_table_says(role: Role, hurt: Callable[[Lab, str], None], tick: int) -> None:
    lab = Lab(flown(role.clusters), uavs_per_node=1, leaders=role.leaders)
    deeds: dict[int, Callable[[], Any]] = {tick: lambda: hurt(lab, role.node)}
    if role.heir:
        deeds[tick + LATER] = lab.leader if role.node == "leader" else lab.agent
    if role.second:
        deeds[tick + PERIOD] = lambda: lab.kill(role.second)
    summary = lab.fly(deeds)
    leads, alone = role.node == "leader", role.leaders == 1
    calendar, back = Schedule(plan_of(flown(role.clusters))), tick + LATER if role.heir else TICKS
    void = [calendar.closes(at) for at in range(tick, back) if calendar.closes(at)] if leads and alone else []

    assert (summary["ticks"], summary["nodes_lost"]) == (TICKS, 2 if role.second else 1)
    assert (summary["lost"], summary["nodes_rejoined"]) == (int(not leads and not role.heir), int(role.heir))
    assert (summary["rounds"], summary["rounds_void"]) == (ROUNDS - len(void), len(void))
    assert [int(text.split()[1]) for text in lab.record.texts if " is void: there is no leader" in text] == void
    same = summary["trajectory_sha256"] == undisturbed(role.clusters)["trajectory_sha256"]
    assert same == (leads and not void)
    relays = [calendar.number(calendar.hops[1], at) for at in range(tick, back)] if role.node == HEAD else []
    without = [int(text.split()[1]) for text in lab.record.texts if "UAV 3: its head is silent" in text]
    assert without == [number for number in relays if number]
    if not leads:  # its UAV flies on without commands, and nobody else's does
        (lost,) = (event for event in lab.record.events if event.kind == "lost")
        (uav,) = lost.uavs
        commands = np.concatenate([block.accelerations for block in lab.record.blocks])
        heir_at = lost.tick + LATER if role.heir else TICKS
        assert not commands[lost.tick + 1 : heir_at + 1, uav].any()
        assert role.heir == bool(commands[heir_at + 2 :, uav].any())
        assert commands[:, 1].any(axis=-1)[2:].all()
        assert lab.world.flight.status[uav] == (Status.FLYING if role.heir else Status.LOST)
    takeovers = [text for text in lab.record.texts if "takes over from" in text]
    heirs = ["leader", "leader.2", "leader.3"][: role.leaders + (leads and role.heir)]
    assert takeovers == [f"{new} takes over from {old}" for old, new in itertools.pairwise(heirs)]


def test_a_paused_head_a_killed_head_and_a_lost_relay_each_cost_their_cluster() -> None:
    script = """faults=[{kind="pause", tick=41, duration_s=0.1, uavs=[4]}, {kind="kill", tick=61, uavs=[8]},
        {kind="partition", tick=81, duration_s=0.1, uavs=[4]}]""".replace("\n", " ")
    lab = Lab(swarm(script, "federation.fraction=1.0", *CLEAR), uavs_per_node=1)
    assert lab.fly()["rounds"] == 5
    silent, lost = "its head is silent", "its relay is lost"
    expected = [(4, 2, silent), (8, 3, silent), (4, 4, lost), (8, 4, silent), (8, 5, silent)]
    assert [event.text for event in lab.record.events if event.kind == "void"] == [
        f"round {number} goes on without the cluster of UAV {head}: {reason}" for head, number, reason in expected
    ]


def test_a_round_in_which_the_leader_hears_no_other_cluster_is_void_and_does_not_wait() -> None:
    cut = "faults=[{kind='partition', tick=40, duration_s=0.2, uavs=[0]}]"
    lab = Lab(swarm(cut, "federation.fraction=1.0", *CLEAR), uavs_per_node=4)
    summary = lab.fly()
    assert (summary["rounds"], summary["rounds_void"]) == (4, 1)
    (text,) = (text for text in lab.record.texts if text.startswith("round 2 is void"))
    assert text.startswith("round 2 is void: no model of another UAV was averaged; 12 of 12 participants sent")


@pytest.mark.parametrize("clusters", [1, CLUSTERS])
def test_a_run_that_is_killed_in_any_phase_of_a_round_is_resumed_to_the_same_end(clusters, monkeypatch) -> None:
    monkeypatch.setattr("meanflock.worldsim.world.REPORT_EVERY_TICKS", 1)
    lab = Lab(flown(clusters), uavs_per_node=4, checkpoint_every=1)
    lab.fly()
    checkpoints = {past.tick: past for past in lab.record.checkpoints}
    expected = undisturbed(clusters)
    for tick in PHASES.values():
        resumed = Lab(flown(clusters), uavs_per_node=2, resume=checkpoints[tick]).fly()
        for name in ("trajectory_sha256", "rounds", "payload_bits", "lost", "uploads_refused"):
            assert resumed[name] == expected[name], tick


@pytest.mark.parametrize(("resumable", "patience_s"), [(True, 10), (False, 310)])
def test_a_leader_that_no_other_can_replace_may_take_as_long_as_a_training(resumable: bool, patience_s: int) -> None:
    rule = {"name": "kept", "resumable": resumable, "weights": lambda _, uploads: np.ones(len(uploads.uavs))}
    mf.register(type("Kept", (mf.Aggregator,), rule))
    lab = Lab(scenario("federation.aggregation=kept", "duration=5"), uavs_per_node=6)
    lab.fly({30: lambda: lab.freeze("leader")})
    (text,) = (event.text for event in lab.record.events if event.kind == "lost")
    assert f"no answer for {patience_s} s" in text


def test_a_leader_that_averages_a_round_again_is_not_heard() -> None:
    lab = Lab(flown(1))
    client = lab.client_of("leader")
    act, outboxes = client._node.act, []

    def again(sense: Sense) -> Act:
        answer = act(sense)
        outboxes.extend(answer.outbox)
        return msgspec.structs.replace(answer, outbox=tuple(outboxes[:1])) if sense.tick == 63 else answer

    client._node.act = again
    summary = lab.fly()
    assert summary["dropped_messages"] == {"duplicate": 1}
    assert summary["rounds"] == ROUNDS - 1
