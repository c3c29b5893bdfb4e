"""Registry of plug-ins: classes found by kind and name, whose source is a package, a file or this process."""

import importlib
import inspect
import re
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from types import FunctionType
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import msgspec

from meanflock.swarm import threads
from meanflock.swarm.errors import FAILURES, BadInput, lacking, last_line, meant

PluginKind: TypeAlias = Literal[
    "controller", "aggregator", "channel", "vehicle", "learner", "filter", "topology", "coding"
]

# Methods that a class must have; the others have defaults in the base classes.
NEEDED: dict[PluginKind, tuple[str, ...]] = {
    "controller": ("init", "step"),
    "aggregator": ("step",),
    "channel": ("transmit",),
    "vehicle": ("step", "power"),
    "learner": ("initial", "fit"),
    "filter": ("init", "step"),
    "topology": ("hops",),
    "coding": ("encode", "decode"),
}
PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")  # a name is part of file names and keys

GROUPS: dict[PluginKind, str] = {
    kind: "meanflock.topologies" if kind == "topology" else f"meanflock.{kind}s" for kind in get_args(PluginKind)
}
HERE = "this process"  # source of a class that was registered by Python code
NO_PLUGIN = (
    "derive a class from meanflock.Controller, Aggregator, Channel, Vehicle, Learner, Filter or Coding and give it a "
    "`name`"
)


class Plugin(NamedTuple):
    """A class that is registered by name: its kind (`controller`, …), its name and its source.

    source: the installed package and its version, or the file. reference: `module:Class` of an entry point, or the
        class in the file. fingerprint: version of the package, or hash of the file; a checkpoint stores it.
    """

    kind: PluginKind
    name: str
    source: str
    reference: str
    fingerprint: str


registered: dict[tuple[PluginKind, str], tuple[Plugin, type]] = {}  # plug-ins that are in no package


@cache
def _packaged() -> dict[tuple[PluginKind, str], tuple[Plugin, ...]]:
    """Every entry point of the groups, without importing any of them."""
    from importlib.metadata import entry_points  # only here: it takes time to load

    found: dict[tuple[PluginKind, str], tuple[Plugin, ...]] = {}
    packages: dict[Any, str] = {}  # name and version by distribution: reading them takes time
    points = entry_points()  # one search for all groups
    for kind, group in GROUPS.items():
        for point in points.select(group=group):
            if point.dist not in packages:
                packages[point.dist] = f"{point.dist.name} {point.dist.version}" if point.dist else "unknown package"
            package = packages[point.dist]
            plugin = Plugin(kind, point.name, package, point.value, package)
            others = found.get((kind, point.name), ())
            if all(other.reference != plugin.reference for other in others):  # a package on the path twice is one
                found[kind, point.name] = (*others, plugin)
    return found


def installed() -> list[Plugin]:
    """All plug-ins, sorted by kind and name."""
    found = [plugin for plugins in _packaged().values() for plugin in plugins]
    found += [plugin for plugin, _ in registered.values()]
    return sorted(found, key=lambda plugin: (list(GROUPS).index(plugin.kind), plugin.name))


def names(kind: PluginKind) -> list[str]:
    """Names of all plug-ins of a kind."""
    return sorted({plugin.name for plugin in installed() if plugin.kind == kind})


def find(kind: PluginKind, name: str) -> Plugin:
    """The plug-in of that name.

    Raises:
        BadInput: there is none, or more than one.
    """
    key = (kind, name)
    candidates = [*_packaged().get(key, ()), *([registered[key][0]] if key in registered else [])]
    if not candidates:
        if name.endswith(".py"):
            raise BadInput(
                f"{kind} {name!r} is not installed here; a key takes a name and no file: load the file with "
                f"--plugin {name}, and give the `name` of its class"
            )
        suggested, option = meant(name, names(kind)), "--learner" if kind == "learner" else "--plugin"
        found = f"there are {', '.join(names(kind))}" if names(kind) else "no other is installed"
        found += "".join(f"; there is {_a(other.kind)} {name!r}" for other in installed() if other.name == name)
        raise BadInput(
            f"{kind} {name!r} is not installed here{suggested + ' Else' if suggested else ';'} install its package, or "
            f"name its file: {option} FILE.py; {found}"
        )
    if len(candidates) > 1:
        where = " and ".join(f"{plugin.reference} ({plugin.source})" for plugin in candidates)
        raise BadInput(f"two {kind}s are named {name!r}: {where}; rename one of them, or uninstall its package")
    return candidates[0]


def load(kind: PluginKind, name: str) -> type:
    """The class of that name.

    Raises:
        BadInput: there is none, it cannot be imported, or it lacks a method.
    """
    plugin = find(kind, name)
    return registered[kind, name][1] if (kind, name) in registered else _class_of(plugin)


@cache
def _class_of(plugin: Plugin) -> type:
    """The class of a plug-in of a package, imported and checked when it is first asked for.

    Raises:
        BadInput: it cannot be imported, or it cannot be a plug-in of that kind.
    """
    module, _, attribute = plugin.reference.partition(":")
    try:
        with threads.pinned_torch():
            found: Any = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except FAILURES as error:
        title = f"{plugin.kind} {plugin.name!r} of {plugin.source}"
        ours = lacking(error, title) if module.startswith("meanflock.") else ""
        raise BadInput(ours or f"{title}: {last_line(error)}") from error
    return checked(plugin.kind, plugin.name, found, plugin.source)


def register(made: type) -> Plugin:
    """Registers a class of this process, for example of a notebook. Registering a name again replaces it.

    Raises:
        BadInput: it is no plug-in, or an installed plug-in has the name.
    """
    if (key := key_of(made)) is None:
        raise BadInput(f"{made!r}: no plug-in; {NO_PLUGIN}")
    entry = registered[key] = entry_of(Plugin(*key, HERE, made.__qualname__, HERE), made)
    return entry[0]


def name_of(label: str, given: Any, kind: PluginKind) -> str:
    """The name of a plug-in of a kind that is given by its name or as its class, which is then registered.

    `label`: what it is given as, for an error.

    Raises:
        BadInput: it is neither, or of another kind, or its class cannot be used.
    """
    if isinstance(given, str):
        return given
    if not isinstance(given, type):
        raise BadInput(f"{label}: {given!r} is neither the name nor the class of {_a(kind)}; give one of these")
    plugin = register(given)
    if plugin.kind != kind:
        raise BadInput(f"{label}: {plugin.reference} is {_a(plugin.kind)}; give the name or the class of {_a(kind)}")
    return plugin.name


def _a(kind: PluginKind) -> str:
    return f"an {kind}" if kind == "aggregator" else f"a {kind}"


def is_file(plugin: Plugin) -> bool:
    """Returns whether a plug-in was registered in this process, and is not of a package."""
    return (plugin.kind, plugin.name) in registered


def is_own(plugin: Plugin) -> bool:
    """Returns whether a plug-in is one of meanflock's own."""
    return not is_file(plugin) and plugin.reference.startswith("meanflock.")


def create(kind: PluginKind, name: str, options: dict[str, Any], *context: Any) -> Any:
    """An instance of the plug-in of that name: `Class(options, *context)`, its options converted to their type.

    Raises:
        BadInput: like `load`; or the options do not fit, or the constructor fails.
    """
    plugin_class: Any = load(kind, name)
    typed = options_of(kind, name, options)
    try:
        return plugin_class(typed, *context)
    except BadInput:
        raise
    except FAILURES as error:
        raise BadInput(f"{kind} {name!r} cannot be made: {last_line(error)}") from error


def dimensions_of(plugin_class: Any) -> Any:
    """The numbers of axes in which a plug-in flies: its `dimensions`, by default the plane alone."""
    return getattr(plugin_class, "dimensions", (2,))


def check_dimensions(kind: PluginKind, name: str, dimensions: int) -> None:
    """Raises BadInput if the plug-in of that name does not fly in so many dimensions, or if there is none."""
    flies = dimensions_of(load(kind, name))
    if dimensions in flies:
        return
    able = []
    for other in names(kind):
        with suppress(BadInput):  # a package that is missing here
            if dimensions in dimensions_of(load(kind, other)):
                able.append(other)
    raise BadInput(
        f"{kind} {name!r} flies in {' and '.join(map(str, flies))} dimensions, and `space.dimensions` is {dimensions}; "
        f"take one that does ({', '.join(able) or 'there is none here'}), or set `space.dimensions` to {flies[0]}"
    )


def options_of(kind: PluginKind, name: str, options: dict[str, Any]) -> Any:
    """The options of the plug-in of that name, converted to their type.

    Raises:
        BadInput: like `load`; or they do not fit.
    """
    plugin_class: Any = load(kind, name)
    try:
        return msgspec.convert(options, plugin_class.Options)
    except msgspec.ValidationError as error:
        from meanflock.swarm.explain import explain  # only here: nodes receive valid options

        asked = f"scenario schema --method {name}" if kind == "controller" else "plugins"
        remedy = f"`meanflock {asked}` lists the options of {name!r}"
        raise BadInput(explain(str(error), plugin_class.Options, options, options_table(kind), remedy)) from error
    except FAILURES as error:  # of a `__post_init__`
        raise BadInput(f"{kind} {name!r}: its options cannot be made: {last_line(error)}") from error


def options_table(kind: PluginKind) -> str:
    """The table of a scenario that holds the options of a kind of plug-in."""
    tables = {
        "controller": "controller",
        "aggregator": "federation.options",
        "channel": "radio.options",
        "learner": "training.options",
        "coding": "federation.payload_options",
    }
    return tables.get(kind, f"{kind}.options")


def key_of(value: Any) -> tuple[PluginKind, str] | None:
    """Kind and name of a plug-in; None for anything else, such as a base class."""
    kind, name = getattr(value, "plugin_kind", None), getattr(value, "name", "")
    return (kind, name) if isinstance(value, type) and kind in GROUPS and isinstance(name, str) and name else None


def entry_of(plugin: Plugin, plugin_class: type, where: str = "") -> tuple[Plugin, type]:
    """A plug-in and its class, checked; raises BadInput if it is invalid, or if a package has its name."""
    key = plugin.kind, plugin.name
    if key in _packaged():
        conflict = f"{plugin.kind} {plugin.name!r} is installed already, of {_packaged()[key][0].source}"
        raise BadInput(f"{where}{conflict}; give yours another name")
    return plugin, checked(*key, plugin_class, plugin.source)


def checked(kind: PluginKind, name: str, found: Any, source: str) -> type:
    """Check a class of a package or file `source`, and return it.

    Raises:
        BadInput: it cannot be a plug-in of that kind under that name.
    """
    if not isinstance(found, type):
        raise BadInput(f"{kind} {name!r} of {source} is a {type(found).__name__}; it must be a class")
    if not PLAIN.fullmatch(name):
        raise BadInput(f"{kind} {name!r} of {source}: a name is up to 64 of A-Z, a-z, 0-9, '-', '_' and '.'")
    lacking = [method for method in NEEDED[kind] if not callable(getattr(found, method, None))]
    lacking += [method for method in dir(found) if getattr(getattr(found, method, None), "__isabstractmethod__", False)]
    if lacking:
        raise BadInput(f"{kind} {name!r} of {source} lacks {' and '.join(f'`{method}`' for method in lacking)}")
    flies = dimensions_of(found)
    if not (isinstance(flies, tuple) and flies and set(flies) <= {2, 3}):
        raise BadInput(f"{kind} {name!r} of {source}: `dimensions` is {flies!r}; it must be (2,), (3,) or (2, 3)")
    options = getattr(found, "Options", None)
    if not (isinstance(options, type) and issubclass(options, msgspec.Struct)):
        raise BadInput(f"{kind} {name!r} of {source}: `Options` must be a msgspec.Struct")
    _check_defaults(f"{kind} {name!r} of {source}", options)
    _check_arguments(f"{kind} {name!r} of {source}", found)
    return found


def _check_arguments(title: str, plugin_class: Any) -> None:
    """Raises BadInput if a method cannot be called as the method of meanflock's base class that it overrides."""
    for method, original in _originals(plugin_class).items():
        written = inspect.getattr_static(plugin_class, method)
        if written is original or not isinstance(written, FunctionType | classmethod | staticmethod):
            continue
        arguments = [name for name, one in _parameters(original).items() if one.kind is one.POSITIONAL_OR_KEYWORD]
        if method == "step" and getattr(plugin_class, "push", False):  # of a vehicle
            arguments.append("push")
        called_with = arguments[isinstance(original, classmethod) or isinstance(written, classmethod | staticmethod) :]
        try:
            inspect.signature(getattr(plugin_class, method)).bind(*called_with)
        except TypeError:
            given = ", ".join(str(one).partition(":")[0] for one in _parameters(written).values())
            decorator = "@classmethod " if isinstance(original, classmethod) else ""
            raise BadInput(
                f"{title}: `{method}` takes ({given}); write {decorator}{method}({', '.join(arguments)})"
            ) from None


def _originals(plugin_class: Any) -> dict[str, Any]:
    """The methods that the base classes of meanflock define for others to override, by name, each as first defined."""
    originals: dict[str, Any] = {}
    for base in reversed(plugin_class.__mro__):
        if base.__module__.startswith("meanflock."):
            for name, value in vars(base).items():
                if isinstance(value, FunctionType | classmethod) and (name == "__init__" or not name.startswith("_")):
                    originals.setdefault(name, value)
    return originals


def _parameters(method: Any) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(getattr(method, "__func__", method)).parameters


def _check_defaults(title: str, options: type[msgspec.Struct]) -> None:
    """Check the defaults of options, because msgspec checks given values only.

    Raises:
        BadInput: a default is no value that its option may have, or the types cannot be read.
    """
    option = ""
    try:
        for field in msgspec.structs.fields(options):
            option = f" of `{field.encode_name}`"
            if field.default is not msgspec.NODEFAULT:
                msgspec.convert(msgspec.to_builtins(field.default), field.type)
    except FAILURES as error:
        raise BadInput(
            f"{title}: the default{option} in `Options` does not fit its type: {last_line(error)}; change one of them"
        ) from error
