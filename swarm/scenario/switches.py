"""Keys that do nothing until another one, their switch, is set: who sets one of them alone has forgotten the other."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

from meanflock.swarm.declared import NO_FILTER


class Switch(NamedTuple):
    """A key of a table, its value that turns something off, one that does not, and the keys that then do nothing."""

    table: str
    key: str
    off: Any
    example: str
    others: tuple[str, ...] | None = None  # none: all others of the table


SWITCHES = (
    Switch("filter", "kind", NO_FILTER, "ecbf"),
    Switch("cost", "separation", 0.0, "0.1", ("separation_range",)),
    Switch("wind", "field_rms", 0.0, "0.5", ("field_length", "field_modes")),
    Switch("federation", "byzantine_fraction", 0.0, "0.2", ("byzantine_kind",)),
)


def check(table: Mapping[str, Any], said: Collection[str] = ()) -> None:
    """Nothing is set for nothing, in what a person wrote of a scenario. A switch that is off where it was said to be
    is what was wanted: of a scenario that is written out, or in a sweep of it.

    Args:
        said: dotted keys of the table that were set on top of it, one by one.

    Raises:
        ValueError: a key is set whose switch is not; the message names both.
    """
    for name, switch, off, example, others in SWITCHES:
        given = table.get(name)
        if not isinstance(given, Mapping) or f"{name}.{switch}" in said or given.get(switch, off) != off:
            continue
        for key in given:
            of_it = key != switch and (others is None or key in others)
            if of_it and (switch not in given or any(f"{one}.".startswith(f"{name}.{key}.") for one in said)):
                raise ValueError(
                    f"`{name}.{key}` does nothing without `{name}.{switch}`; set that too, for example "
                    f"{name}.{switch}={example}"
                )
