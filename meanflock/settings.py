"""Makes a scenario from the arguments of the Python API: a name or a file, options, and dotted keys."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar, cast, overload

from meanflock.federation.plan import plan_of
from meanflock.studies.swept import refuse_method
from meanflock.swarm import paths, plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.flown import FlownVehicles

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned", covariant=True)


class WithSettings(Protocol[Arguments, Returned]):
    """Type of a function that takes dotted keys as further keywords.

    A type checker compares the values of `**{"wind.sigma": 0.2}` with every named parameter, and no signature can
    exclude that. The second form accepts them; the first shows the parameters in an editor.
    """

    @overload
    def __call__(self, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned: ...
    @overload
    def __call__(self, *args: Any, **settings: Any) -> Returned: ...


def with_settings(function: Callable[Arguments, Returned]) -> WithSettings[Arguments, Returned]:
    """The function itself; type checkers accept `**{"wind.sigma": 0.2}` as keywords of it."""
    return cast(WithSettings[Arguments, Returned], function)


def load_plugins(given: str | Path | Sequence[str | Path] | None) -> None:
    """Registers the plug-ins of one or several files, in this process and those that it starts.

    Raises:
        BadInput: a file cannot be used.
    """
    if given is not None:
        plugins.load_files(given if isinstance(given, Sequence) and not isinstance(given, str | bytes) else [given])


def learner_named(given: str | Path | type, option: str = "--learner") -> str:
    """Name of a learner, given as its name, its class or the file that has it; class or file are then registered.

    `option`: the option that names it, for an error.

    Raises:
        BadInput: it cannot be used, or the file has no learner, or several.
    """
    if isinstance(given, type):
        return plugins.name_of(option, given, "learner")
    if not isinstance(given, str | Path):
        raise BadInput(f"{option}: {given!r} is no learner; give its name, its class or its file")
    if paths.given(given).suffix != ".py":
        return plugins.find("learner", str(given)).name
    plugins.load_files([given], option)
    path = str(paths.given(paths.given(given).resolve()))
    of_file = [plugin for plugin in plugins.installed() if plugin.source == path]
    found = [plugin.name for plugin in of_file if plugin.kind == "learner"]
    if len(found) == 1:
        return found[0]
    if not found:
        others = " and ".join(f"{plugin.kind} {plugin.name!r}" for plugin in of_file)
        raise BadInput(
            f"{option} {given}: no learner in it, but {others}; load it with --plugin, or derive a class from "
            "meanflock.Learner and give it a `name`"
        )
    raise BadInput(f"{option} {given}: several learners, {' and '.join(found)}; use --plugin, and {option} NAME")


def scenario_of(scenario: str | Path | Scenario | None, settings: Mapping[str, Any], **options: Any) -> Scenario:
    """A shipped scenario by name (`"paper"`), a TOML file, or a Scenario, with some keys set.

    Args:
        settings: values by dotted key, such as `{"wind.sigma": 0.2}`. options: top-level keys; None: not set. `method`
            may be a controller's class, which is then registered.

    Raises:
        BadInput: no such scenario, or an invalid key or value.
    """
    given = {key: value for key, value in options.items() if value is not None} | dict(settings)
    if isinstance(scenario, Scenario):
        flown = scenario.replace(**given)
    else:
        flown = Scenario(**given) if scenario is None else Scenario.load(scenario, **given)
    if "method" in given:
        refuse_method(flown)
    check_flyable(flown, "scenario" if isinstance(scenario, Scenario | None) else str(scenario))
    return flown


def check_flyable(flown: Scenario, where: str) -> None:
    """Make the plan and the vehicles of a scenario, and the options of its rule. `where`: source of the scenario.

    Raises:
        BadInput: the scenario cannot be flown here; the message begins with its source.
    """
    given = plan_of(flown, where).given
    try:
        plugins.options_of("aggregator", given.federation.aggregation, given.federation.options)
        FlownVehicles(given)
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error
