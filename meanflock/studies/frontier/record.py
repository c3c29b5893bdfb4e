"""The record of a frontier, frontier.json, from which its table, pictures and page are made."""

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from meanflock.results import statistics
from meanflock.results.quantities import Field
from meanflock.results.statistics import Estimate
from meanflock.swarm import durable, paths
from meanflock.swarm.errors import BadInput

SCHEMA = 1
FILE, TABLE = "frontier.json", "policies.csv"

FIELDS = (  # of `frontier.json`: a cell is a controller in a mission with a number of UAVs and an outage
    Field("schema", "1", "version of this record"),
    Field("version", "", "version of meanflock"),
    Field("code", "", "version and fingerprint of the code that flew"),
    Field("first_seed", "1", "first seed of the search"),
    Field("confirmation_seed", "1", "first seed of the confirmation"),
    Field("flights", "flights", "largest number of flights of a policy, in the search and in the confirmation"),
    Field("survey", "flights", "first flights of a policy, by which shares compare; dearer policies than needed fly 2"),
    Field("targets.share", "1", "share of free flights to show"),
    Field("targets.flights", "flights", "number of flights that show it"),
    Field("targets.failures", "flights", "number of these that may fail"),
    Field("absent.*", "", "reason why a controller cannot fly a mission, by mission, number of UAVs and controller"),
    Field("cells.mission", "", "name of the mission"),
    Field("cells.row", "", "name of the row"),
    Field("cells.controller", "", "name of its controller"),
    Field("cells.settings.*", "", "scenario keys that the row sets"),
    Field("cells.yours", "", "whether the controller is from a file of the user"),
    Field("cells.uavs", "UAVs", "number of UAVs"),
    Field("cells.outage", "1", "probability that a broadcast of a state of 64 bits fails"),
    Field("cells.target_snr_db", "dB", "the key `radio.target_snr_db` that gives this outage"),
    Field("cells.error", "1", "bound on the probability that a target's policy is named although its share is less"),
    Field("cells.policies.name", "", "name of the policy; from cheap to dear"),
    Field("cells.policies.settings.*", "", "scenario keys that the policy sets"),
    Field("cells.policies.verdicts", "", "result of the policy for each target, in their order"),
    Field("cells.policies.search.free", "", "whether each flight was free of collisions and hits, in order of seeds"),
    Field("cells.policies.search.kbit", "kbit", "payload of each flight until the last arrival"),
    Field("cells.policies.search.arrived", "1", "share of the UAVs that arrived in each flight"),
    Field("cells.policies.confirmation.*", "", "the same of the flights of the confirmation"),
    Field("cells.reached.policy", "", "for each target the cheapest policy that reached it; null if none did"),
    Field("cells.reached.failures", "flights", "number of its flights in the confirmation that were not free"),
    Field("cells.reached.bound", "1", "one-sided 95 % bound of the share of free flights, from the confirmation alone"),
    Field("cells.reached.kbit", "kbit", "mean payload of the confirmation"),
    Field("cells.reached.kbit_low", "kbit", "lower end of its 95 % interval"),
    Field("cells.reached.kbit_high", "kbit", "upper end of its 95 % interval"),
    Field("cells.best", "", "policy with the best share in the survey; of equals the one that flew most"),
    Field("cells.why", "", "reason of the first flight that failed"),
)


class Outcomes(msgspec.Struct, frozen=True):
    """Flights in the order of their seeds. kbit: until the last arrival. arrived: share of the UAVs."""

    free: list[bool]
    kbit: list[float]
    arrived: list[float]

    def share(self, flights: int | None = None) -> Estimate:
        """Share of free flights among the first ones, with the interval of Clopper and Pearson."""
        return statistics.share(self.free[:flights])


class PolicyRecord(msgspec.Struct, frozen=True):
    """A policy in a cell. verdicts: one for each target."""

    name: str
    settings: dict[str, Any]
    verdicts: list[str]
    search: Outcomes
    confirmation: Outcomes


class Reached(msgspec.Struct, frozen=True):
    """A target that was reached: policy, failures and bound of the confirmation, and its mean payload with the ends of
    the 95 % interval, kbit."""

    policy: str
    failures: int
    bound: float
    kbit: float
    kbit_low: float
    kbit_high: float


class FrontierCell(msgspec.Struct, frozen=True):
    """A controller in a mission with a number of UAVs and an outage. policies: from cheap to dear. reached: one for
    each target. error: bound on the probability of a wrong name, for each target. best: policy with the best share."""

    mission: str
    row: str
    controller: str
    settings: dict[str, Any]
    yours: bool
    uavs: int
    outage: float
    target_snr_db: float
    error: float
    policies: list[PolicyRecord]
    reached: list[Reached | None]
    best: str
    why: str = ""

    def policy(self, name: str) -> PolicyRecord:
        """A policy by its name."""
        return next(policy for policy in self.policies if policy.name == name)


class Target(msgspec.Struct, frozen=True):
    """A share of free flights, and the plan that shows it."""

    share: float
    flights: int
    failures: int

    @property
    def name(self) -> str:
        """The share in per cent."""
        return f"{100 * self.share:g} %"


class FrontierRecord(msgspec.Struct, frozen=True):
    """A frontier, see `FIELDS`."""

    schema: int
    version: str
    code: str
    first_seed: int
    confirmation_seed: int
    flights: int
    survey: int
    targets: list[Target]
    absent: dict[str, str]
    cells: list[FrontierCell]

    def encode(self) -> bytes:
        """JSON, a line a cell."""
        plain = msgspec.to_builtins(self)
        cells = ",\n".join(map(_json, plain.pop("cells")))
        return f'{_json(plain)[:-1]}, "cells": [\n{cells}\n]}}\n'.encode()

    def write(self, out: Path) -> list[Path]:
        """Writes `out`/frontier.json and `out`/policies.csv.

        Raises:
            RunFailed: the disk is full.
        """
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(self.rows())
        return [durable.put(out / FILE, self.encode()), durable.put(out / TABLE, text.getvalue().encode())]

    def rows(self) -> Iterator[list[Any]]:
        """A head, then a row for each policy of each cell: its share of free flights and its bits."""
        yield [
            *("mission", "row", "uavs", "outage", "policy", "kbit", "flights", "free", "low", "high", "all_flights"),
            *("all_free", *(f"verdict_{100 * target.share:g}" for target in self.targets)),
        ]
        for cell in self.cells:
            for policy in cell.policies:
                share = policy.search.share(self.survey)
                kbit = statistics.mean(policy.search.kbit[: self.survey]).value
                yield [
                    *(cell.mission, cell.row, cell.uavs, cell.outage, policy.name, f"{kbit:.5g}", share.n),
                    *(round(share.value * share.n), f"{share.low:.4f}", f"{share.high:.4f}"),
                    *(len(policy.search.free), sum(policy.search.free), *policy.verdicts),
                ]

    def sizes(self) -> list[int]:
        """The numbers of UAVs, ascending."""
        return sorted({cell.uavs for cell in self.cells})

    def cells_of(self, mission: str, uavs: int | None = None) -> list[FrontierCell]:
        """The cells of a mission, and of a number of UAVs."""
        return [cell for cell in self.cells if cell.mission == mission and uavs in (None, cell.uavs)]

    def missions(self) -> list[str]:
        """The missions in their order."""
        return list(dict.fromkeys(cell.mission for cell in self.cells))


def read(path: Path) -> FrontierRecord:
    """Read a frontier.

    Raises:
        BadInput: the file is not a frontier of this version.
    """
    try:
        found = msgspec.json.decode(paths.read(path), type=FrontierRecord)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give the frontier.json of `meanflock frontier`") from error
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: no frontier: {error}") from error
    if found.schema != SCHEMA:
        raise BadInput(f"{path}: a frontier of schema {found.schema}, this reads {SCHEMA}; fly it again")
    return found


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
