"""Objectives of a study: numbers of its flights, each with the end that is better."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from meanflock.channel.meter import TRAFFIC
from meanflock.federation.plan import plan_of
from meanflock.results.better import Better, better
from meanflock.results.quantities import COMPARED, DERIVED, FIELDS, SUMMARY, full_label, number
from meanflock.results.rounds_table import MEAN, METRIC
from meanflock.results.stored_run import unit_of
from meanflock.studies.each_round import LAST_ROUND
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, meant
from meanflock.swarm.scenario import Scenario

SHORT = {  # short names of fields of the summary
    "bits": "payload_bits.total",
    "airtime": "radio.airtime_s",
    "seconds": "sim_time_s",
    "time": "t_avg_censored_s",
    "energy": "energy_total_J",
}
ROUNDING = 1e-6  # relative difference below which two numbers are equal: models on the air are rounded
_ENDS = ("less", "more")
_OF_GROUPS = "groups.*."
_GROUP_FIELD = re.compile(r"groups\.(?P<group>[^.]+)\.(?P<field>.+)")
_UNTIL = "until."  # begins the fields of flights that end at a metric


@dataclass(frozen=True)
class Objective:
    """A number of each flight.

    name: as it was asked for. keys: dotted keys of a summary, of which the first that it has counts. better: which end
    is better.
    """

    name: str
    keys: tuple[str, ...]
    better: Better

    def values(self, summaries: Sequence[Mapping[str, Any]]) -> list[float]:
        """The number of each flight; NaN if it has none."""
        return [next(filter(math.isfinite, (_number(each, key) for key in self.keys)), math.nan) for each in summaries]

    @property
    def label(self) -> str:
        """Name or symbol, with the unit in brackets."""
        key = self.keys[0]
        if key in FIELDS:
            return full_label(key)
        if (of_group := _GROUP_FIELD.fullmatch(key)) and of_group["field"] in FIELDS:
            return f"{of_group['group']}: {full_label(of_group['field'])}"
        unit = unit_of(key)
        return self.name if unit in ("", "1") else f"{self.name.removesuffix(f'_{unit}')} ({unit})"


COMPARED_OBJECTIVES = tuple(Objective(key, (key,), cast(Better, better(key))) for key in COMPARED)


def objective(text: str, scenarios: Collection[Scenario], flag: str) -> Objective:
    """The objective of a text: a field of the summary, a short name of one, or what is reported of the last round.

    `NAME=less` and `NAME=more` say which end is better, where nobody knows it or to say otherwise.

    Raises:
        BadInput: none of the flights has such a field, or nobody knows which end is better; the text begins with
            `flag`.
    """
    name, equals, end = (part.strip() for part in text.partition("="))
    if equals and end not in _ENDS:
        raise BadInput(f"{flag} {text}: write NAME, NAME=less or NAME=more")
    key, fields = SHORT.get(name, name), _fields(scenarios)
    if key in fields and key.startswith(_UNTIL) and all(flown.until is None for flown in scenarios):
        raise BadInput(f"{flag} {text}: no flight ends at a metric; add --until, for example --until accuracy=0.9")
    if key in fields:
        keys: tuple[str, ...] = (key,)
    elif name in (reported := _reported(scenarios)) or None in reported:
        keys = (f"{LAST_ROUND}.{METRIC}{name}", f"{LAST_ROUND}.{MEAN}{name}")
    else:
        names = {*SHORT, *fields, *filter(None, reported)}
        raise BadInput(
            f"{flag} {text}: no flight has such a number{meant(name, names)}; name a number of summary.json, as "
            f"energy_mean_J, {', '.join(SHORT)}, or what the methods report of a round"
            + (f": {', '.join(sorted(filter(None, reported)))}" if any(reported) else "")
        )
    if not equals and (end := better(keys[0]) or "") not in _ENDS:
        raise BadInput(f"{flag} {text}: is less or more of it better? Write {name}=less or {name}=more")
    return Objective(name, keys, cast(Better, end))


def _fields(scenarios: Collection[Scenario]) -> set[str]:
    """The fields of the summaries of flights that are numbers."""
    found = {field.key for field in (*SUMMARY, *DERIVED) if field.unit}
    of_groups = {key for key in found if key.startswith(_OF_GROUPS)}
    groups = {group.name for flown in scenarios for group in flown.groups}
    found = (found - of_groups) | {key.replace("*", name, 1) for key in of_groups for name in groups}
    for key in [key for key in found if "*" in key]:
        found.remove(key)
        found |= {key.replace("*", kind) for kind in (*TRAFFIC.values(), "total") if key.count("*") == 1}
    return found


def _reported(scenarios: Collection[Scenario]) -> set[str | None]:
    """What any of the flights reports of a round; None among them if a rule may report anything."""
    names: set[str | None] = set()
    for flown in scenarios:
        for declared in (group.declared for group in plan_of(flown).groups):
            if declared.is_federated:
                rule = plugins.load("aggregator", flown.federation.aggregation)
                names |= {*declared.diagnostics, *([None] if getattr(rule, "reports_metrics", False) else [])}
    return names


def _number(summary: Mapping[str, Any], key: str) -> float:
    try:
        return number(summary, key)
    except BadInput:
        return math.nan
