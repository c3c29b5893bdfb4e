"""The points of a study in words: by the values that tell them apart."""

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from meanflock.results.scenario_keys import group_and_key

METHOD = "method"
_PLUGINS = (METHOD, "training.learner")


def labels(names: Sequence[str], points: Iterable[tuple[Any, ...]]) -> dict[tuple[Any, ...], str]:
    """The label of each point: its values of the names that vary, or of all if none does.

    Methods and learners come first, without a name. Keys are without their table if that is enough to tell them apart.
    Methods of groups are left out where `method` tells them.
    """
    points = dict.fromkeys(points)
    places = sorted(telling(names, points), key=lambda place: names[place] not in _PLUGINS)
    varying = [place for place in places if len({point[place] for point in points}) > 1] or places
    ends = [name.rpartition(".")[2] for name in names]
    shown = [end if ends.count(end) == 1 else name for end, name in zip(ends, names, strict=True)]
    return {
        point: ", ".join(
            str(point[place]) if names[place] in _PLUGINS else f"{shown[place]}={point[place]}" for place in varying
        )
        for point in points
    }


def telling(names: Sequence[str], points: Collection[tuple[Any, ...]]) -> list[int]:
    """Places of the names that tell points apart: `method` names the controllers of all groups, so theirs are left out
    if points still differ.
    """
    keys = [(place, *group_and_key(name)) for place, name in enumerate(names)]
    places = [place for place, group, key in keys if not group or key != METHOD]
    differ = len({tuple(point[place] for place in places) for point in points}) == len(points)
    return places if differ else [*range(len(names))]
