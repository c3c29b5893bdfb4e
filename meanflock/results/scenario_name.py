"""Name of the scenario of a run: that of its file, or of a shipped scenario. The run's `scenario.toml` has it."""

import re
from contextlib import suppress
from pathlib import Path

from meanflock.swarm import paths
from meanflock.swarm.scenario import Scenario

_LONGEST = 40  # characters
_HEAD = re.compile(rf"# flown as ([\w-]{{1,{_LONGEST}}})\r?\n")
_OF_A_RUN = "scenario.toml"


def scenario_name(given: str | Path | Scenario | None) -> str | None:
    """Name of a given scenario, with `-` for all but letters, digits, `-` and `_`; None: it has none.

    The scenario in a run folder has the name as which it was flown. It is also a part of keys of the bus.
    """
    if isinstance(given, Scenario):
        return None
    if given is None:
        return "paper"
    path = paths.given(given)
    if path.name == _OF_A_RUN and path.is_file():  # a pipe can be read only once
        with suppress(OSError, ValueError):
            if name := name_in(path.read_text(encoding="utf-8")):
                return name
    return re.sub(r"[^\w-]+", "-", path.stem)[:_LONGEST].strip("-") or None


def headed(text: str, name: str | None) -> str:
    """The text of a scenario file, with the name in its first line."""
    return text if name is None else f"# flown as {name}\n{text}"


def name_in(text: str) -> str | None:
    """The name in the text of a scenario file; None: it has none."""
    found = _HEAD.match(text)
    return found[1] if found else None
