"""Policies of communication: what the UAVs of a row send, when, how often and in which coding."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import msgspec

from meanflock.federation.plan import plan_of
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.swarm.errors import BadInput, meant

SILENT = "silent"
OWN = "own"  # of a row that sets the keys itself, or of a controller that knows none of them
_KEYS = {"states": ("sharing.",), "models": ("federation.payload", "federation.broadcast_payload")}


class CommunicationPolicy(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A policy. settings: dotted keys of the scenario."""

    name: str
    settings: dict[str, Any] = {}  # msgspec copies it

    def applied_to(self, row: BoardRow) -> BoardRow:
        """The row under this policy, under the same name."""
        return msgspec.structs.replace(row, method=row.controller, settings={**row.settings, **self.settings})


def shipped() -> dict[str, tuple[CommunicationPolicy, ...]]:
    """The policies of policies.toml: of `states` and of `models`."""
    return msgspec.toml.decode(
        Path(__file__).with_name("policies.toml").read_bytes(), type=dict[str, tuple[CommunicationPolicy, ...]]
    )


def check(names: Sequence[str]) -> None:
    """Check names of policies.

    Raises:
        BadInput: there is no policy of that name.
    """
    every = [policy.name for policies in shipped().values() for policy in policies]
    for name in names:
        if name not in every:
            raise BadInput(
                f"--policies {name}: no such policy{meant(name, every)}; there are {', '.join(every)}, or all"
            )


def of_row(row: BoardRow, table: dict[str, Any], where: str, names: Sequence[str] = ()) -> list[CommunicationPolicy]:
    """The policies under which a row flies a mission's table: those of what its UAVs send; silent if that is nothing.

    Args:
        names: policies to choose from, where a kind has any of them; empty for all.

    Raises:
        BadInput: the row does not fit the mission.
    """
    declared = plan_of(row.scenario(table, 1, where)).declared
    kinds = [kind for kind, sends in (("states", declared.shares), ("models", declared.is_federated)) if sends]
    parts = [_of_kind(kind, row, names) for kind in kinds]
    if not parts:
        return [CommunicationPolicy(OWN if declared.broadcast_numbers else SILENT)]
    return [
        CommunicationPolicy(
            ", ".join(policy.name for policy in each), {k: v for policy in each for k, v in policy.settings.items()}
        )
        for each in product(*parts)
    ]


def _of_kind(kind: str, row: BoardRow, names: Sequence[str]) -> Sequence[CommunicationPolicy]:
    if any(key.startswith(_KEYS[kind]) for key in row.settings):
        return [CommunicationPolicy(OWN)]
    every = shipped()[kind]
    return [policy for policy in every if policy.name in names] or every
