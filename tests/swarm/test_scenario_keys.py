"""The keys of a scenario: each has a description, and the paper's number as its default."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from meanflock.swarm import scenario
from meanflock.swarm.scenario import load


def leaves(schema: dict[str, Any], node: dict[str, Any], path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every leaf key with what the schema says of it."""
    for name, entry in node["properties"].items():
        target = entry
        for part in (entry, *entry.get("allOf", []), *entry.get("anyOf", [])):
            if "$ref" in part:
                target = schema["$defs"][part["$ref"].rsplit("/", 1)[-1]]
        if "properties" in target:
            yield from leaves(schema, target, f"{path}{name}.")
        else:
            yield f"{path}{name}", entry


def test_the_schema_describes_every_leaf_key() -> None:
    schema = scenario.schema()
    found = dict(leaves(schema, schema["$defs"]["Scenario"]))
    for name, entry in found.items():
        assert any(part.get("description") for part in (entry, *entry.get("anyOf", []))), name

    def keys(table: dict[str, Any], path: str = "") -> Iterator[str]:
        for name, value in table.items():
            if isinstance(value, dict) and value:  # options of a plug-in are a leaf: only it knows them
                yield from keys(value, f"{path}{name}.")
            else:
                yield f"{path}{name}"

    assert set(found) == set(keys(msgspec.to_builtins(load(None))))


def test_the_defaults_are_the_numbers_of_the_paper() -> None:
    default = load(None)
    assert load(Path(__file__).parents[2] / "scenarios" / "paper.toml").sha256() == default.sha256()
    assert default.start.spacing == math.sqrt(2)
    assert default.metrics.hazard_radius == math.sqrt(2) / 2
    assert default.participants == 20
    assert default.max_ticks == 3000
