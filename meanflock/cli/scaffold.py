"""Packages for new plug-ins: source that flies as it is, entry point, conformance test and CI file."""

import keyword
import os
import re
import shutil
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import Literal, TypeAlias, cast

from meanflock.cli.catalogue import KEYS
from meanflock.swarm import __version__, durable, plugins
from meanflock.swarm.errors import BadInput

Kind: TypeAlias = Literal["controller", "aggregator", "channel", "vehicle", "learner", "filter", "coding"]
_THINGS: dict[Kind, str] = {
    "controller": "controller",
    "aggregator": "aggregation rule",
    "channel": "channel",
    "vehicle": "vehicle",
    "learner": "learner",
    "filter": "filter",
    "coding": "coding",
}
_TEMPLATES = Path(__file__).with_name("templates")
_TAKEN = "exists already; take another name, or another working folder"
_LONGEST = 64  # characters of a name


def create(kind: Kind, name: str, parent: Path) -> list[Path]:
    """Write the package `parent`/`name` of a new plug-in, all of it or nothing.

    Returns:
        The paths of its files.

    Raises:
        BadInput: the name or the folder cannot be used.
        RunFailed: the disk is full.
    """
    folder = parent / name
    if os.path.lexists(folder):
        raise BadInput(f"{folder}: {_TAKEN}")
    _check(kind, name)
    values = {
        "kind": kind,
        "name": name,
        "Class": _class_of(name),
        "thing": _THINGS[kind],
        "keys": _keys(kind, name),
        "group": plugins.GROUPS[kind],
        "flight": flight(kind, name),
        "version": __version__,
    }
    templates = {
        Path("pyproject.toml"): "pyproject",
        Path("README.md"): "readme",
        Path("src", name, "__init__.py"): kind,
        Path("tests", f"test_{name}.py"): "test",
        Path(".github", "workflows", "test.yml"): "workflow",
        Path(".gitignore"): "gitignore",
    }
    part = parent / f".{name}.{os.urandom(4).hex()}.part"
    try:
        part.mkdir()
    except OSError as error:
        raise BadInput(f"{folder}: {error.strerror}; go to a folder that can be written") from error
    try:
        for path, template in templates.items():
            text = Template((_TEMPLATES / f"{template}.template").read_text(encoding="utf-8")).substitute(values)
            (part / path).parent.mkdir(parents=True, exist_ok=True)
            (part / path).write_text(text, encoding="utf-8")
        part.rename(folder)
    except OSError as error:
        if os.path.lexists(folder):  # another process was faster
            raise BadInput(f"{folder}: {_TAKEN}") from error
        raise durable.not_written(folder, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return [folder / path for path in templates]


def flight(kind: Kind, name: str) -> str:
    """The command that flies the new plug-in."""
    chosen = {"controller": f"--method {name}", "learner": f"--method plan --learner {name}"}
    return f"meanflock run {chosen.get(kind, f'--set {KEYS[kind]}={name}')} --in-process"


def _keys(kind: Kind, name: str) -> str:
    """The keys of a scenario that flies the new plug-in, as Python."""
    return repr({KEYS[kind]: name} | ({"method": "plan"} if kind == "learner" else {})).replace("'", '"')


def _check(kind: Kind, name: str) -> None:
    """Check that a plug-in, a module and a class may have the name.

    Raises:
        BadInput: one of them may not.
    """
    if not _is_module(name):
        other = re.sub(r"\W", "_", name)
        raise BadInput(
            f"{name}: no name for a module; take a letter, and then letters, digits and underscores, up to {_LONGEST}"
            + (f", as in `{other}`" if _is_module(other) else "")
        )
    if keyword.iskeyword(name) or keyword.iskeyword(_class_of(name)):
        raise BadInput(f"{name}: a keyword of Python, or its class would be; take another name")
    for plugin in plugins.installed():
        if (plugin.kind, plugin.name) == (cast(plugins.PluginKind, kind), name):
            raise BadInput(f"{name}: a {kind} of that name is installed, of {plugin.source}; take another name")
    if find_spec(name) is not None:
        raise BadInput(f"{name}: Python has a module of that name; take another name")


def _is_module(name: str) -> bool:
    return name.isidentifier() and name.isascii() and name[0].isalpha() and len(name) <= _LONGEST


def _class_of(name: str) -> str:
    """Name of the class: `wind_map` becomes `WindMap`."""
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))
