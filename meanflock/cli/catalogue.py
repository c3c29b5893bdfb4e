"""Catalogue of the installed plug-ins with their options: as text, as JSON, and in the schema of a scenario."""

import inspect
import sys
import textwrap
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec

from meanflock.swarm import plugins, scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins import GROUPS, Plugin, PluginKind, options_table

KEYS: dict[PluginKind, str] = {  # of a scenario, that names the plug-in
    "controller": "method",
    "aggregator": "federation.aggregation",
    "channel": "radio.model",
    "vehicle": "vehicle.model",
    "learner": "training.learner",
    "filter": "filter.kind",
    "topology": "federation.topology",
    "coding": "federation.payload",
}
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
_ABBREVIATIONS = {"al.", "cf.", "ch.", "e.g.", "eq.", "fig.", "i.e.", "no.", "sec.", "vs."}
_INDENT, _ABOUT = " " * 2, " " * 4


class Option(NamedTuple):
    """An option, read from its annotation. about: its meaning and unit. default: as in JSON."""

    name: str
    kind: str
    bounds: str
    required: bool
    default: Any
    about: str

    @property
    def value(self) -> str:
        """The default as in a scenario file."""
        return "required" if self.required else msgspec.json.encode(self.default).decode()


class Entry(NamedTuple):
    """A plug-in. about: the first sentence of its docstring. fault: why it cannot be used, if so."""

    plugin: Plugin
    about: str = ""
    options: tuple[Option, ...] = ()
    fault: str = ""


def catalogue() -> list[Entry]:
    """All plug-ins, installed or named by --plugin, by kind and name."""
    return [_entry(plugin) for plugin in plugins.installed()]


def _entry(plugin: Plugin) -> Entry:
    try:
        found: Any = plugins.load(plugin.kind, plugin.name)
        return Entry(plugin, _about(found), tuple(_options(found.Options)))
    except (BadInput, TypeError) as error:
        return Entry(plugin, fault=str(error))


def _about(found: type) -> str:
    """The first sentence of the docstring of a class, or else of its file."""
    docstring = found.__dict__.get("__doc__") or sys.modules[found.__module__].__doc__ or ""
    words = inspect.cleandoc(docstring).partition("\n\n")[0].split()
    end = next((number for number, word in enumerate(words, 1) if _ends_a_sentence(word)), len(words))
    sentence = " ".join(words[:end])
    return f"{sentence.removesuffix('.')}." if sentence else ""


def _ends_a_sentence(word: str) -> bool:
    plain = word.lstrip("(").lower()
    is_initial = len(plain) == len("j.")
    return plain.endswith(".") and not is_initial and plain not in _ABBREVIATIONS


def schema_of_options(options: type[msgspec.Struct]) -> dict[str, Any]:
    """JSON schema of the options of a plug-in."""
    (reference,), components = msgspec.json.schema_components([options])
    schema: dict[str, Any] = components[reference["$ref"].rpartition("/")[2]]
    return schema


def _options(options: type[msgspec.Struct]) -> Iterator[Option]:
    schema = schema_of_options(options)
    for name, key in schema["properties"].items():
        bounds = [f"{sign} {key[word]:g}" for word, sign in _BOUNDS.items() if word in key]
        bounds += [" | ".join(map(str, key["enum"]))] if "enum" in key else []
        of_parts = (part.get("type") or " | ".join(map(str, part.get("enum", "?"))) for part in key.get("anyOf", ()))
        about, required = key.get("description", ""), name in schema.get("required", ())
        yield Option(
            name, key.get("type") or " | ".join(of_parts), ", ".join(bounds), required, key.get("default"), about
        )


def text(entries: list[Entry], width: int) -> str:
    """The catalogue as text, in lines of at most `width` characters."""
    lines: list[str] = []
    for kind, key in KEYS.items():
        of_kind = [entry for entry in entries if entry.plugin.kind == kind]
        group, options = GROUPS[kind].removeprefix("meanflock."), f", options in [{options_table(kind)}]"
        lines += [*([""] if lines else []), f"{group}: `{key}`{options if kind != 'topology' else ''}"]
        if not of_kind:
            lines.append(f"{_INDENT}none")
        for entry in of_kind:
            lines += _wrapped(f"{entry.plugin.name}  ({entry.plugin.source})", _INDENT, width)
            lines += _wrapped(f"cannot be used: {entry.fault}" if entry.fault else entry.about, _ABOUT, width)
            for option in entry.options:
                described = "; ".join(filter(None, (f"{option.kind} {option.bounds}".strip(), option.about)))
                lines += _wrapped(f"- {option.name} = {option.value}  {described}", _ABOUT, width)
    return "\n".join(lines)


def _wrapped(line: str, indent: str, width: int) -> list[str]:
    return textwrap.wrap(line, width, initial_indent=indent, subsequent_indent=f"{indent}  ", break_long_words=False)


def records(entries: list[Entry]) -> list[dict[str, Any]]:
    """The catalogue as JSON records."""
    return [
        {
            **{name: getattr(entry.plugin, name) for name in ("kind", "name", "source", "reference", "fingerprint")},
            "key": KEYS[entry.plugin.kind],
            "about": entry.about,
            "options": [option._asdict() for option in entry.options],
            "fault": entry.fault or None,
        }
        for entry in entries
    ]


def schema(method: str | None = None) -> dict[str, Any]:
    """JSON schema of a scenario file; with a `method`, its [controller] has the options of that controller.

    Raises:
        BadInput: the controller is not installed, or cannot be used.
    """
    whole = scenario.schema()
    if method is None:
        return whole
    found: Any = plugins.load("controller", method)
    (reference,), components = msgspec.json.schema_components([found.Options], ref_template="#/$defs/controller.{name}")
    defs, properties = whole["$defs"], whole["$defs"]["Scenario"]["properties"]
    defs.update({f"controller.{name}": component for name, component in components.items()})
    properties["controller"] = reference | {"description": f"options of {method}"}
    properties["method"] = properties["method"] | {"const": method}
    return whole
