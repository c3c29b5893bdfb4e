"""Registry of plug-ins by kind and name: controllers, aggregation rules, topologies, channels, vehicles and filters.

A plug-in is a class with a `name`. It is in an entry-point group of an installed package, or in a file that was named
on the command line of this machine. Messages of the network contain the name only; a name that is not registered here
is refused.
"""

import hashlib
import importlib
import os
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, get_args

import msgspec

from meanflock.swarm.errors import BadInput
from meanflock.swarm.failures import FAILURES, PLUGIN_MODULE, beside, last_line
from meanflock.swarm.libraries import lacking
from meanflock.swarm.plugin_class import Door, checked
from meanflock.swarm.source_read import SourceRead

GROUPS: dict[Door, str] = {
    door: "meanflock.topologies" if door == "topology" else f"meanflock.{door}s" for door in get_args(Door)
}
HERE = "this process"  # the source of a class that is in no file
NO_PLUGIN = "derive a class from meanflock.Controller, Aggregator, Channel, Vehicle or Filter and give it a `name`"
FILES = "MEANFLOCK_PLUGINS"  # a variable: the files a process registers when it starts, as PATH separates them


class Plugin(NamedTuple):
    """A class that is registered by name: its kind (`controller`, …), its name and its source.

    source: the installed package and its version, or the file. reference: `module:Class` of an entry point, or the
        class in the file. fingerprint: version of the package, or hash of the file; a checkpoint stores it.
    """

    kind: Door
    name: str
    source: str
    reference: str
    fingerprint: str


_files: dict[tuple[Door, str], tuple[Plugin, type]] = {}


@cache
def _packaged() -> dict[tuple[Door, str], tuple[Plugin, ...]]:
    """Every entry point of the groups, without importing any of them."""
    from importlib.metadata import entry_points  # only here: a process that is told everything by file need not

    found: dict[tuple[Door, str], tuple[Plugin, ...]] = {}
    for door, group in GROUPS.items():
        for point in entry_points(group=group):
            package = f"{point.dist.name} {point.dist.version}" if point.dist is not None else "unknown package"
            plugin = Plugin(door, point.name, package, point.value, package)
            others = found.get((door, point.name), ())
            if all(other.reference != plugin.reference for other in others):  # a package on the path twice is one
                found[door, point.name] = (*others, plugin)
    return found


def installed() -> list[Plugin]:
    """All plug-ins, sorted by kind and name."""
    found = [plugin for plugins in _packaged().values() for plugin in plugins]
    found += [plugin for plugin, _ in _files.values()]
    return sorted(found, key=lambda plugin: (list(GROUPS).index(plugin.kind), plugin.name))


def names(door: Door) -> list[str]:
    """What can be named at a door."""
    return sorted({plugin.name for plugin in installed() if plugin.kind == door})


def find(door: Door, name: str) -> Plugin:
    """The plug-in of that name.

    Raises:
        BadInput: there is none, or more than one.
    """
    key = (door, name)
    candidates = [*_packaged().get(key, ()), *([_files[key][0]] if key in _files else [])]
    if not candidates:
        from difflib import get_close_matches  # only here: no agent needs it

        close = get_close_matches(name, names(door), 1)
        mend = f"did you mean {close[0]!r}? Else install" if close else "install"
        raise BadInput(
            f"{door} {name!r} is not installed here; {mend} its package, or name its file: --plugin FILE.py; "
            f"there are {', '.join(names(door)) or 'none'}"
        )
    if len(candidates) > 1:
        where = " and ".join(f"{plugin.reference} ({plugin.source})" for plugin in candidates)
        raise BadInput(f"two {door}s are named {name!r}: {where}; rename one of them, or uninstall its package")
    return candidates[0]


def load(door: Door, name: str) -> type:
    """The class of that name.

    Raises:
        BadInput: there is none, it cannot be imported, or it lacks a method.
    """
    plugin = find(door, name)
    if (door, name) in _files:
        return _files[door, name][1]
    module, _, attribute = plugin.reference.partition(":")
    try:
        found: Any = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except FAILURES as error:
        what = f"{door} {name!r} of {plugin.source}"
        ours = lacking(error, what, "world") if module.startswith("meanflock.") else ""
        raise BadInput(ours or f"{what}: {last_line(error)}") from error
    return checked(door, name, found, plugin.source)


def load_file(path: Path | str) -> list[Plugin]:
    """Registers every plug-in of a file: its public classes with a `name` that are derived from a base class of ours.

    Raises:
        BadInput: the file cannot be read or run, or there is none in it.
    """
    where, path = f"--plugin {path}", Path(path).resolve()  # a file is the same one, however somebody named it
    try:
        source = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{where}: {error.strerror}; name a readable Python file") from error
    if path.suffix != ".py":
        raise BadInput(f"{where}: not a Python file; its name must end in .py")
    name = f"{PLUGIN_MODULE}{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    module = sys.modules[name] = ModuleType(name)
    module.__file__ = str(path)
    try:
        SourceRead(name, path, source).exec_module(module)
    except FAILURES as error:
        del sys.modules[name]
        raise BadInput(f"{where}: {last_line(error)}{beside(path, error)}") from error
    entries = {}
    for key, (attribute, value) in _defined(module, where).items():
        if key in _files and _files[key][0].source not in (str(path), HERE):
            raise BadInput(
                f"{where}: two {key[0]}s are named {key[1]!r}, the other in {_files[key][0].source}; rename one"
            )
        entries[key] = _entry(Plugin(*key, str(path), attribute, fingerprint(source)), value, f"{where}: ")
    if not entries:
        raise BadInput(f"{where}: no plug-in in it; {NO_PLUGIN}")
    _files.update(entries)
    return [plugin for plugin, _ in entries.values()]


def _defined(module: ModuleType, where: str) -> dict[tuple[Door, str], tuple[str, type]]:
    """The plug-ins that a module defines, by door and name, and what they are called in it."""
    found: dict[tuple[Door, str], tuple[str, type]] = {}
    for attribute, value in vars(module).items():
        key = _key(value) if getattr(value, "__module__", None) == module.__name__ else None
        if key is None:
            continue
        other, made = found.setdefault(key, (attribute, value))
        if made is not value:
            both = f"{other} and {attribute}"
            raise BadInput(f"{where}: two {key[0]}s are named {key[1]!r}, {both}; give one of them another `name`")
    return found


def register(made: type) -> Plugin:
    """Registers a class of this process, for example of a notebook. Registering a name again replaces it.

    Raises:
        BadInput: it is no plug-in, or the name is taken by one that is installed.
    """
    if (key := _key(made)) is None:
        raise BadInput(f"{made!r}: no plug-in; {NO_PLUGIN}")
    entry = _files[key] = _entry(Plugin(*key, HERE, made.__qualname__, HERE), made)
    return entry[0]


def fingerprint(source: bytes) -> str:
    """Of the contents of a file."""
    return f"sha256 {hashlib.sha256(source).hexdigest()}"


def is_file(plugin: Plugin) -> bool:
    """Whether a plug-in came from a file that somebody named, and not from a package."""
    return (plugin.kind, plugin.name) in _files


def load_files(paths: Iterable[Path | str]) -> None:
    """Registers the plug-ins of some files, here and in every process this one starts.

    Raises:
        BadInput: like `load_file`.
    """
    given = [Path(path).resolve() for path in paths]
    for path in given:
        if os.pathsep in str(path):  # other processes are told of it by a variable
            raise BadInput(f"--plugin {path}: no {os.pathsep!r} may be in its path; give the file another place")
        load_file(path)
    if given:
        before = [part for part in os.environ.get(FILES, "").split(os.pathsep) if part]
        os.environ[FILES] = os.pathsep.join(dict.fromkeys([*before, *map(str, given)]))


def files() -> tuple[tuple[str, str], ...]:
    """Path and fingerprint of every file that is registered here, for a process that works for this one."""
    return tuple({plugin.source: plugin.fingerprint for plugin, _ in _files.values() if plugin.source != HERE}.items())


def hold(wanted: Iterable[tuple[str, str]]) -> None:
    """Registers the files another process has, those again whose contents are no longer what they were.

    Raises:
        BadInput: like `load_file`.
    """
    held = {(plugin.source, plugin.fingerprint) for plugin, _ in _files.values()}
    for path, contents in wanted:
        if (path, contents) not in held:
            load_file(path)


def create(door: Door, name: str, options: dict[str, Any], *context: Any) -> Any:
    """An instance of the plug-in of that name: `Class(options, *context)`, its options converted to their type.

    Raises:
        BadInput: like `load`; or the options do not fit, or the class cannot be made of them.
    """
    made: Any = load(door, name)
    try:
        typed = msgspec.convert(options, made.Options)
    except msgspec.ValidationError as error:
        from meanflock.swarm.explain import explain  # only here: nodes are sent options that are sound

        asked = f"scenario schema --method {name}" if door == "controller" else "plugins"
        mend = f"`meanflock {asked}` lists the options of {name!r}"
        raise BadInput(explain(str(error), made.Options, options, options_table(door), mend)) from error
    except FAILURES as error:  # of a `__post_init__`
        raise BadInput(f"{door} {name!r}: its options cannot be made: {last_line(error)}") from error
    try:
        return made(typed, *context)
    except BadInput:
        raise
    except FAILURES as error:
        raise BadInput(f"{door} {name!r} cannot be made: {last_line(error)}") from error


def options_table(door: Door) -> str:
    """The table of a scenario that holds the options of a door's plug-in."""
    tables = {"controller": "controller", "aggregator": "federation.options", "channel": "radio.options"}
    return tables.get(door, f"{door}.options")


def _key(made: Any) -> tuple[Door, str] | None:
    """Door and name of a plug-in; None of anything else, such as a class others derive from."""
    door, name = getattr(made, "door", None), getattr(made, "name", "")
    return (door, name) if isinstance(made, type) and door in GROUPS and isinstance(name, str) and name else None


def _entry(plugin: Plugin, made: type, where: str = "") -> tuple[Plugin, type]:
    """What is registered of it, or BadInput."""
    key = plugin.kind, plugin.name
    if key in _packaged():
        there = f"{plugin.kind} {plugin.name!r} is installed already, of {_packaged()[key][0].source}"
        raise BadInput(f"{where}{there}; give yours another name")
    return plugin, checked(*key, made, plugin.source)
