"""The difference of two finished runs: scenario keys, and figures of the summary."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from meanflock.results.quantities import SUMMARY, VARYING
from meanflock.results.scenario_keys import changed_keys, flat
from meanflock.results.stored_run import StoredFolder, unit_of

_NO_FIGURES = VARYING | {"schema", "uavs", "seed"}
_ORDER = list(dict.fromkeys(field.key.partition(".")[0] for field in SUMMARY))


class Figure(NamedTuple):
    """A field of the summary that differs: its dotted key, its unit, and its values; None: unknown."""

    key: str
    unit: str
    first: float | None
    second: float | None

    @property
    def change(self) -> float | None:
        """Second minus first value; None if one is unknown."""
        return None if self.first is None or self.second is None else self.second - self.first


class Difference(NamedTuple):
    """Differences between two runs. keys: with both values; None: unset. compared: number of compared figures."""

    first: StoredFolder
    second: StoredFolder
    keys: dict[str, tuple[Any, Any]]
    figures: list[Figure]
    compared: int

    @property
    def same_flight(self) -> bool:
        """Returns whether the states of all ticks are bit-identical."""
        return bool(self.first.summary["trajectory_sha256"] == self.second.summary["trajectory_sha256"])

    def record(self) -> dict[str, Any]:
        """The difference as a JSON object."""
        return {
            "a": str(self.first.folder),
            "b": str(self.second.folder),
            "same_flight": self.same_flight,
            "keys": {key: {"a": a, "b": b} for key, (a, b) in self.keys.items()},
            "figures": {
                figure.key: {"unit": figure.unit, "a": figure.first, "b": figure.second, "change": figure.change}
                for figure in self.figures
            },
        }


def difference(first: StoredFolder, second: StoredFolder) -> Difference:
    """The difference of two finished runs."""
    figures = list(_figures(first, second))
    differing = [figure for figure in figures if figure.first != figure.second]
    return Difference(first, second, changed_keys(first.keys, second.keys), differing, len(figures))


def _figures(first: StoredFolder, second: StoredFolder) -> Iterator[Figure]:
    """All figures of both runs, in the order of the registry."""
    flats = [flat(run.summary) for run in (first, second)]
    for key in sorted(dict.fromkeys([*flats[0], *flats[1]]), key=_place):
        values = [one.get(key) for one in flats]
        if key.partition(".")[0] not in _NO_FIGURES and all(map(_is_number, values)):
            yield Figure(key, unit_of(key), *values)


def _place(key: str) -> int:
    """Place of a key in the order of the registry."""
    top = key.partition(".")[0]
    return _ORDER.index(top) if top in _ORDER else len(_ORDER)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | None) and not isinstance(value, bool)
