"""The rows of a leaderboard: controllers with settings."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from meanflock.federation.plan import plan_of
from meanflock.swarm import plugins, toml
from meanflock.swarm.errors import BadInput, meant
from meanflock.swarm.scenario import Scenario, validated
from meanflock.swarm.scenario.tables import POLICIES

ALL = "all"


class BoardRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row as rows.toml has it.

    name: in tables. method: the controller; unset: as `name`. about: short description. settings: dotted keys of
    the scenario, for all missions. missions: those it can fly; empty for all. yours: from a file of the user.
    family: the rows that have one colour in the pictures.
    """

    name: str
    method: str = ""
    about: str = ""
    settings: dict[str, Any] = {}  # msgspec copies it
    missions: tuple[str, ...] = ()
    yours: bool = False
    family: str = ""

    @property
    def controller(self) -> str:
        """The name of its controller."""
        return self.method or self.name

    def under(self, policies: Sequence[str], table: dict[str, Any], where: str) -> list["BoardRow"]:
        """The row for each policy of communication, named such as `orca/event` if there are several.

        A row whose UAVs share no states is returned once, unchanged, and so is one that sets `sharing` itself.
        """
        own = any(key.partition(".")[0] == "sharing" for key in self.settings)
        if not policies or own or not plan_of(self.scenario(table, 1, where)).declared.shares:
            return [self]
        return [
            msgspec.structs.replace(
                self,
                method=self.controller,
                name=self.name if len(policies) == 1 else f"{self.name}/{policy}",
                settings={**self.settings, "sharing.policy": policy},
            )
            for policy in policies
        ]

    def training(self, learner: str, table: dict[str, Any], where: str) -> "BoardRow":
        """The row with a learner that trains in flight.

        Raises:
            BadInput: its controller shares a model of its own, or is not installed, or a setting does not fit.
        """
        if plan_of(self.scenario(table, 1, where)).declared.is_federated:
            raise BadInput(f"shares a model of its own, so learner {learner!r} cannot share another")
        settings = {**self.settings, "training.learner": learner}
        return msgspec.structs.replace(self, method=self.controller, settings=settings)

    def flies(self, mission: str) -> bool:
        """Returns whether the row can fly a mission."""
        return not self.missions or mission in self.missions

    def scenario(self, table: dict[str, Any], seed: int, where: str) -> Scenario:
        """A mission's table as this row flies it.

        Raises:
            BadInput: its controller is not installed, or a setting does not fit.
        """
        table = msgspec.to_builtins(table)  # a copy
        for key, value in self.settings.items():
            toml.put(table, key, value, where)
        flown = validated({**table, "method": self.controller, "seed": seed}, Scenario, where)
        plan_of(flown)  # who cannot fly it says so now
        return flown


def shipped() -> tuple[BoardRow, ...]:
    """The rows of rows.toml, in their order."""
    text = Path(__file__).with_name("rows.toml").read_bytes()
    return msgspec.toml.decode(text, type=dict[str, tuple[BoardRow, ...]])["row"]


def family(name: str, controller: str) -> str:
    """The family of the shipped row with a name and controller, else that of the first one with the controller; empty
    if there is none.
    """
    same = [row for row in shipped() if row.controller == controller]
    return next((row.family for row in same if row.name == name), same[0].family if same else "")


def chosen(names: Iterable[str]) -> list[BoardRow]:
    """Rows by name, each once; `all` for those of rows.toml and every controller of the reader's files. Another name
    may be that of a controller, which flies with its defaults.

    Raises:
        BadInput: a name that is neither.
    """
    table = {row.name: row for row in shipped()}
    installed = plugins.names("controller")
    yours = [name for name in installed if plugins.is_file(plugins.find("controller", name))]
    rows: dict[str, BoardRow] = {}
    for name in names:
        if name == ALL:
            rows |= table | {mine: BoardRow(mine, yours=True) for mine in yours}
        elif name in table:
            rows[name] = table[name]
        elif name in installed:
            rows[name] = BoardRow(name, yours=name in yours)
        else:
            others = [other for other in installed if other not in table]
            raise BadInput(
                f"--controllers {name}: no such row or controller{meant(name, [*table, *others])}; rows are "
                f"{', '.join(table)}; other controllers are "
                f"{', '.join(others) or 'none'}; a file of yours is named with --plugin FILE.py"
            )
    return list(rows.values())


def policies(names: Iterable[str]) -> list[str]:
    """Policies of communication by name, each once; `all` for every policy.

    Raises:
        BadInput: no such policy.
    """
    found: dict[str, None] = {}
    for name in names:
        if name != ALL and name not in POLICIES:
            raise BadInput(
                f"--policies {name}: no such policy{meant(name, POLICIES)}; there are {', '.join(POLICIES)}, or all"
            )
        found |= dict.fromkeys(POLICIES if name == ALL else (name,))
    return list(found)
