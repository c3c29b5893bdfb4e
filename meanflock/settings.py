"""A scenario from what somebody wrote in Python: a name or a file, options, and dotted keys."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from meanflock.swarm import plugins, scenarios
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, from_table
from meanflock.swarm.toml import put, read


def load_plugins(given: str | Path | Sequence[str | Path] | None) -> None:
    """Registers the plug-ins of a file or several, for this process and those it starts.

    Raises:
        BadInput: one cannot be used.
    """
    if given is not None:
        plugins.load_files([given] if isinstance(given, str | Path) else given)


def as_builtins(value: Any) -> Any:
    """What somebody wrote, as a TOML file could have it: numbers and arrays of NumPy are numbers and lists.

    Raises:
        TypeError: it is something else.
    """
    return msgspec.to_builtins(value, enc_hook=_of_numpy)


def _of_numpy(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no value of a scenario")


def scenario_of(scenario: str | Path | Scenario | None, settings: Mapping[str, Any], **options: Any) -> Scenario:
    """A shipped scenario by name (`"paper"`), a TOML file, or a Scenario, with some keys set.

    Args:
        settings: values by dotted key, such as `{"wind.sigma": 0.2}`. options: top-level keys; None: not set. `method`
            may be a controller's class, which is then registered.

    Raises:
        BadInput: no such scenario, or a key or value that is none.
    """
    if isinstance(scenario, Scenario):
        table: dict[str, Any] = as_builtins(scenario)
    elif scenario is None:
        table = {}
    else:
        path = Path(scenario)
        table = read(path if path.suffix else scenarios.FOLDER / f"{scenario}.toml", "scenario")
    method = options.get("method")
    if isinstance(method, type):
        plugins.register(method)
        options["method"] = method.name  # type: ignore[attr-defined]
    elif not isinstance(method, str | None):
        raise BadInput(f"method: {method!r} is no name of a controller and no class; give one of these")
    for key, value in {**{k: v for k, v in options.items() if v is not None}, **settings}.items():
        try:
            put(table, key, as_builtins(value))
        except TypeError as error:
            raise BadInput(f"{key}: {error}; give a number, a text, a list or a dict") from error
    flown = from_table(table, "scenario", settings)
    flown.declared  # noqa: B018  # whoever cannot fly it hears of it now
    return flown
