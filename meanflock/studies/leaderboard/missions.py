"""The missions of a leaderboard: scenarios without controllers."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from meanflock.results.scenario_keys import flat
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.swarm import paths, toml
from meanflock.swarm.errors import BadInput, meant
from meanflock.swarm.scenario import Scenario, validated

ALL = "all"
# Keys that rows set. Missions set places, wind and radio.
_OF_ROWS = ("method", "controller", "filter", "sharing", "seed", "federation.period", "federation.options")
ACCELERATION_MAX_M_S2 = 6.0  # of a mission that sets no limit itself


class BoardMission(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """name: of its scenario file. title, about: in words. time_price_W: price of a second, J/s, if a mission weighs
    energy against time, else None."""

    name: str
    title: str = ""
    about: str = ""
    time_price_W: float | None = None  # a unit

    def table(self) -> dict[str, Any]:
        """The scenario as plain values, without the keys that rows set, and with a limit of acceleration.

        Raises:
            BadInput: the file is damaged.
        """
        table, _ = self._divided()
        return table

    def own_row(self) -> BoardRow | None:
        """The row of a mission whose groups all name a controller, with the keys of the file that rows set. It is the
        only one, because with any other the UAVs would fly the same. None: rows can fly the mission.

        Raises:
            BadInput: the file is damaged.
        """
        table, own = self._divided()
        if not validated(table, Scenario, self.name).every_group_has("method"):
            return None
        settings = {key: value for key, value in flat(own).items() if key not in ("method", "seed")}
        return BoardRow(Path(self.name).stem, table["groups"][0]["method"], self.about, settings)

    def _divided(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The table, and the keys of the file that rows set."""
        table = toml.read(_path(self.name), "mission")
        validated(table, Scenario, self.name)
        own: dict[str, Any] = {}
        for key in _OF_ROWS:
            *parents, last = key.split(".")
            part = table
            for parent in parents:
                part = part.get(parent, {})
            if last in part:
                toml.put(own, key, part.pop(last))
        for each in (table, *(group for group in table.get("groups", ()) if "vehicle" in group)):
            each.setdefault("vehicle", {}).setdefault("acceleration_max", ACCELERATION_MAX_M_S2)
        return table, own


def shipped() -> tuple[BoardMission, ...]:
    """The missions of missions.toml, in their order."""
    text = Path(__file__).with_name("missions.toml").read_bytes()
    return msgspec.toml.decode(text, type=dict[str, tuple[BoardMission, ...]])["mission"]


def chosen(names: Iterable[str]) -> list[BoardMission]:
    """Missions by name, each once; `all` for those of missions.toml. Any other shipped scenario or a TOML file is one,
    too.

    Raises:
        BadInput: an unknown name.
    """
    known = {mission.name: mission for mission in shipped()}
    missions: dict[str, BoardMission] = {}
    for name in names:
        if name == ALL:
            missions |= known
        elif name in known:
            missions[name] = known[name]
        elif paths.given(name).is_file() or _path(name) in toml.shipped():
            missions[name] = BoardMission(name, Path(name).stem)
        else:
            what = f"no such mission{meant(name, known)}"
            raise BadInput(f"--missions {name}: {what}; there are {', '.join(known)}; or name a TOML file")
    return list(missions.values())


def refuse_rows(missions: Iterable[BoardMission], remedy: str) -> None:
    """Raise BadInput if rows would fly a mission that has a row of its own. `remedy`: what mends it, in words."""
    for mission in missions:
        if mission.own_row() is not None:
            raise BadInput(
                f"--controllers: every group of the mission {mission.name} names its controller, so all rows would be "
                f"the same flight; {remedy}"
            )


def _path(name: str) -> Path:
    return paths.given(name) if Path(name).suffix else toml.FOLDER / f"{name}.toml"
