"""Who may say and hear what: the access-control list of the router, default deny, one certificate a node.

The router matches the common name of the certificate a link was opened with, which nobody but the holder of the
key can show. The router's own session, the world, is not filtered: it is the one everyone trusts.
"""

from typing import Any

from meanflock.swarm.net import keys
from meanflock.swarm.net.identity import LEADER, STATION, WORLD

Rule = tuple[str, list[str], list[str]]  # flow as the router sees it, messages, keys


def rules(run: str, uavs: int, uavs_per_process: int) -> dict[str, Any]:
    """Zenoh's `access_control` for a run: agents, leader and station under their own keys, and nobody else at all."""
    who = {LEADER: _node(run, LEADER, LEADER), STATION: _station(run)}
    for uav in range(0, uavs, uavs_per_process):
        name = keys.asker("agent", uav)
        who[name] = _node(run, "agent", name)
    numbered = {
        name: [
            {"id": f"{name}/{number}", "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": under}
            for number, (flow, messages, under) in enumerate(allowed)
        ]
        for name, allowed in who.items()
    }
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for its in numbered.values() for rule in its],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in who],
        "policies": [{"rules": [rule["id"] for rule in its], "subjects": [name]} for name, its in numbered.items()],
    }


def _node(run: str, role: str, name: str) -> list[Rule]:
    return [
        *_member(run, role, name),
        ("ingress", ["put"], [keys.act(run, life) for life in _lives(name)]),
        ("ingress", ["declare_subscriber"], [keys.sense(run, life) for life in _lives(name)]),
        ("egress", ["put"], [keys.sense(run, life) for life in _lives(name)]),
        # Without the world's subscription, the node's publisher would match nobody and send nothing.
        ("egress", ["declare_subscriber"], [keys.act(run, "*")]),
    ]


def _station(run: str) -> list[Rule]:
    return [
        *_member(run, STATION, STATION),
        ("ingress", ["put"], [keys.received(run)]),
        ("ingress", ["declare_subscriber"], [keys.telemetry(run)]),
        ("egress", ["put"], [keys.telemetry(run)]),
        ("egress", ["declare_subscriber"], [keys.received(run)]),
    ]


def _member(run: str, role: str, name: str) -> list[Rule]:
    """What everyone may: ask to take part under its own name, be alive under it, and see whether the world is."""
    world = keys.alive(run, WORLD, WORLD)
    return [
        ("ingress", ["query"], [keys.join(run, name)]),
        ("egress", ["reply"], [keys.join(run, name)]),
        ("egress", ["declare_queryable"], [keys.join(run)]),
        ("ingress", ["liveliness_token"], [keys.alive(run, role, life) for life in _lives(name)]),
        ("ingress", ["liveliness_query", "declare_liveliness_subscriber"], [world]),
        ("egress", ["liveliness_token"], [world]),
    ]


def _lives(name: str) -> tuple[str, str]:
    """A node that comes back has a number behind its name: agent-3, agent-3.2, agent-3.3 …"""
    return name, f"{name}.$*"


NOBODY = rules("-", 0, 1)  # no run has that name
