"""The names that users rely on, as rows of kind and name: `python -m tests.golden.names` writes them to names.csv.

The file has the names of the last release. A name that is in the file and not in the code was renamed or removed.
"""

import csv
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

import meanflock as mf
from meanflock import env, testing
from meanflock.results import event_log, quantities
from meanflock.swarm import errors, plugins, scenario
from meanflock.swarm.events import KINDS
from meanflock.swarm.toml import shipped
from tests.pages import commands, script_of

TABLE = Path(__file__).with_suffix(".csv")
Name = tuple[str, str]  # kind, name


def read() -> list[Name]:
    """The rows of the file."""
    with TABLE.open(newline="", encoding="utf-8") as file:
        return [(kind, name) for kind, name in csv.reader(file)]


def names() -> list[Name]:
    """The names of the code."""
    found = [*_commands(), *_exit_codes(), *_scenarios(), *_plugins(), *_results(), *_python()]
    return sorted(set(found))


def _commands() -> Iterator[Name]:
    for path, command in commands().items():
        if isinstance(command, click.Group):
            continue
        verb = " ".join(path)
        yield "command", verb
        for parameter in command.params:
            spelling = parameter.opts if isinstance(parameter, click.Option) else [(parameter.name or "").upper()]
            yield from (("option", f"{verb} {option}") for option in [*spelling, *parameter.secondary_opts])


def _exit_codes() -> Iterator[Name]:
    codes = {name.removeprefix("EXIT_"): getattr(errors, name) for name in dir(errors) if name.startswith("EXIT_")}
    yield from (("exit code", f"{code} {name.lower().replace('_', ' ')}") for name, code in codes.items())


def _scenarios() -> Iterator[Name]:
    yield from (("scenario", path.stem) for path in shipped())
    schema = scenario.schema()["$defs"]
    for key, described in schema["Scenario"]["properties"].items():
        inner = schema[described["$ref"].rpartition("/")[2]]["properties"] if "$ref" in described else {}
        yield from (("key", name) for name in ([f"{key}.{each}" for each in inner] or [key]))
    for key, described in schema["Scenario"]["properties"].items():
        if "$ref" in (item := described.get("items", {})):
            table = schema[item["$ref"].rpartition("/")[2]]["properties"]
            yield from (("key", f"{key}.{name}") for name in table)
    for item in schema["Scenario"]["properties"]["faults"]["items"]["anyOf"]:
        fault = schema[item["$ref"].rpartition("/")[2]]["properties"]
        kind = fault.pop("kind")["enum"][0]
        yield from (("key", f"faults.{kind}.{name}") for name in fault)


def _plugins() -> Iterator[Name]:
    """Groups of entry points, and the plug-ins of meanflock with their options."""
    for kind, group in plugins.GROUPS.items():
        yield "entry points", group
        for name in plugins.names(kind):
            yield kind, name
            options = plugins.load(kind, name).Options.__struct_fields__  # type: ignore[attr-defined]
            yield from ((f"{kind} option", f"{name} {option}") for option in options)


def _results() -> Iterator[Name]:
    yield from (("summary field", field.key) for field in quantities.SUMMARY)
    columns = (*quantities.COLUMNS_BEFORE, *quantities.COLUMNS_AFTER)
    yield from (("column", column.key) for column in columns)
    yield from (("event field", name) for name in event_log.FIELDS)
    yield from (("event kind", name) for name in KINDS)


def _python() -> Iterator[Name]:
    for module in (mf, env, testing):
        for name in module.__all__:
            path = f"{module.__name__}.{name}"
            yield "python", path
            yield from _members(path, getattr(module, name))


def _members(path: str, value: Any) -> Iterator[Name]:
    """Parameters of a function, and members of a class that the reference shows, with the parameters of its methods."""
    if inspect.isclass(value):
        others = [base for base in value.__mro__ if not base.__module__.startswith("meanflock")]
        foreign = set().union(*map(dir, others))
        members = dict.fromkeys(inspect.get_annotations(value)) | dict(inspect.getmembers(value))
        shown = script_of("api").MEMBERS.get(value.__name__, members.keys() - foreign)
        for name in shown:
            if not name.startswith("_"):
                yield "python", f"{path}.{name}"
                yield from _members(f"{path}.{name}", members[name])
    elif inspect.isfunction(value) or inspect.ismethod(value):
        parameters = inspect.signature(value).parameters
        yield from (("python", f"{path}({name})") for name in parameters if name != "self")


def write() -> None:
    """Writes the names of the code."""
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(names())


if __name__ == "__main__":
    write()
