"""Writes keys.md, the reference of scenario keys, from the types of a scenario, and keys.csv for shells."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from meanflock.cli import catalogue
from meanflock.cli.completion import KEYS as COMPLETED
from meanflock.swarm import plugins, scenario
from meanflock.swarm.scenario import OURS, PRINTED, SILENT

PAGE = Path(__file__).with_suffix(".md")
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def page() -> str:
    """The whole page."""
    schema = scenario.schema()["$defs"]
    lines = [
        "# Scenario keys",
        "",
        "`python docs/keys.py` writes this page; a test compares it with the code. A scenario is a TOML file. A key",
        "that it leaves out has the default. Set a key for one flight with `--set wind.sigma=0.3`, or in Python with",
        '`mf.fly("paper", **{"wind.sigma": 0.3})`. A wrong key, type or value is refused before anything flies.',
        "",
        f"*The paper*: **{PRINTED}**: the default is the value that the paper prints. **{SILENT}**: the paper has",
        f"the quantity but no value. **{OURS}**: the paper has no such quantity. *Why*: the reason for the default.",
        "",
        "## Top level",
        "",
        "These keys stand before the first table of the file.",
        "",
        *_table(schema, "Scenario", ""),
    ]
    for name, key in schema["Scenario"]["properties"].items():
        if "$ref" in key:
            table = key["$ref"].rpartition("/")[2]
            lines += ["", f"## [{name}]", "", schema[table]["description"], "", *_table(schema, table, f"{name}.")]
    lines += [
        "",
        *_entries(schema, "obstacles", "Obstacle"),
        *_entries(schema, "stations", "Station"),
        *_entries(schema, "groups", "GroupTable"),
        *_entries(schema, "radios", "UnequalRadio"),
        "## [[faults]]",
        "",
        "The fault script. Each entry says what goes wrong, for which UAVs, when and for how long, in simulated time.",
        "A fault begins at `tick` or at `time_s`; meanflock warns of one that begins after `duration`. With",
        "`harmless = true` a fault declares that it does not change the flight.",
        "A file with faults alone is flown with `--faults FILE`.",
        "",
        "| kind | what it does | keys |",
        "|---|---|---|",
    ]
    for fault in _faults(schema):
        own = schema[fault]["properties"]
        keys = [
            f"`{name}`{_meaning(key)}"
            for name, key in own.items()
            if name not in ("kind", "tick", "time_s", "harmless")
        ]
        kind = own["kind"]["enum"][0]
        lines.append(f"| `{kind}` | {' '.join(schema[fault]['description'].split())} | {'; '.join(keys)} |")
    return "\n".join(lines) + "\n"


def keys() -> list[str]:
    """Every dotted key except those of faults."""
    schema = scenario.schema()["$defs"]
    found = []
    for name, key in schema["Scenario"]["properties"].items():
        inner = schema[key["$ref"].rpartition("/")[2]]["properties"] if "$ref" in key else None
        found += [name] if inner is None else [f"{name}.{one}" for one in inner]
    return found


def completed() -> str:
    """The keys that a shell completes, as CSV: those with values that fit on a line, and options of our plug-ins."""
    schema = scenario.schema()["$defs"]
    rows: dict[tuple[str, str, str, str], list[str]] = {}  # names of plug-ins by key, its choice, values and meaning
    named = {key: kind for kind, key in catalogue.KEYS.items()}
    for key in keys():
        table, _, name = key.rpartition(".")
        described = schema["Scenario"]["properties"]
        if table:
            described = schema[described[table]["$ref"].rpartition("/")[2]]["properties"]
        if key not in ("controller", "faults", "groups", "obstacles", "radios", "stations") and name != "options":
            values = [*_values(described[name])]
            if kind := named.get(key):
                default = described[name].get("default")
                values = [default] if default and default not in plugins.names(kind) else []
                values.append(plugins.GROUPS[kind])
            rows[key, "", " ".join(values), _description(described[name])] = []
    for plugin in plugins.installed():
        if plugin.source.startswith("meanflock "):
            found: Any = plugins.load(plugin.kind, plugin.name)
            for name, key in catalogue.schema_of_options(found.Options)["properties"].items():
                values = " ".join(_values(key))
                row = (f"{plugins.options_table(plugin.kind)}.{name}", catalogue.KEYS[plugin.kind], values)
                rows.setdefault((*row, _description(key)), []).append(plugin.name)
    written = io.StringIO()
    lines = csv.writer(written, lineterminator="\n")
    for (key, choice, values, about), names in rows.items():
        lines.writerow((key, f"{choice}={' '.join(names)}" if names else "", values, about))
    return written.getvalue()


def _values(key: dict[str, Any]) -> Iterator[str]:
    """The values of a key, if it has a few."""
    if key.get("type") == "boolean":
        yield from ("true", "false")
    yield from map(str, key.get("enum", ()))
    for part in key.get("anyOf", ()):
        yield from _values(part)


def _faults(schema: dict[str, Any]) -> Iterator[str]:
    for item in schema["Scenario"]["properties"]["faults"]["items"]["anyOf"]:
        yield item["$ref"].rpartition("/")[2]


def _entries(schema: dict[str, Any], name: str, table: str) -> list[str]:
    """A section about a list of tables, whose keys have descriptions."""
    properties = schema[table]["properties"].items()
    rows = [f"| `{key}` | {_described(key, of_key)} |" for key, of_key in properties]
    about = " ".join(schema[table]["description"].split())
    return [f"## [[{name}]]", "", about, "", "| key | what |", "|---|---|", *rows, ""]


def _described(key: str, of_key: dict[str, Any]) -> str:
    """The description of a key, which may be that of one of its types; a table is described where it stands alone."""
    texts = [of_key, *of_key.get("anyOf", ())]
    found = next((one["description"] for one in texts if "description" in one), f"as `[{key}]`, for this group")
    return " ".join(found.split())


def _table(schema: dict[str, Any], table: str, prefix: str) -> Iterator[str]:
    yield "| key | what | unit | bounds | default | the paper | why |"
    yield "|---|---|---|---|---|---|---|"
    described = scenario.keys_of(scenario.Scenario)
    for name, key in schema[table]["properties"].items():
        if "$ref" in key:
            continue
        path = prefix + name
        about, paper, reason, unit, _ = described[path]
        cells = (f"`{path}`", about, unit, _bounds(_typed(key)), _default(key), paper, reason)
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _typed(key: dict[str, Any]) -> dict[str, Any]:
    """The key itself, or its part that is not null."""
    return next((part for part in key.get("anyOf", ()) if part.get("type") != "null"), key)


def _bounds(key: dict[str, Any]) -> str:
    if "enum" in key:
        return ", ".join(f"`{value}`" for value in key["enum"])
    bounds = [f"{sign} {_number(key[word])}" for word, sign in _BOUNDS.items() if word in key]
    kind = {"boolean": "true, false", "object": "a table", "string": "a name", "array": "two numbers"}
    if key.get("type") == "array" and "prefixItems" not in key:
        return "pairs of numbers" if "prefixItems" in key["items"] else "tables"
    return ", ".join(bounds) or kind.get(key.get("type", ""), "")


def _default(key: dict[str, Any]) -> str:
    value = key.get("default")
    if value is None:
        return "unset"
    if isinstance(value, dict) or value == ():
        return "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple | list):
        return f"`[{', '.join(map(_number, value))}]`"
    return f"`{value if isinstance(value, str) else _number(value)}`"


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def _meaning(key: dict[str, Any]) -> str:
    about = _description(key)
    return f": {about}" if about else ""


def _description(key: dict[str, Any]) -> str:
    about: str = _typed(key).get("description") or key.get("description", "")
    return about


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    COMPLETED.write_text(completed(), encoding="utf-8")
