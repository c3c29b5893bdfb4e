"""The keys of a scenario: each described, each with the paper's number as its default."""

import math
import tomllib
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
    root = schema["$defs"]["Scenario"]
    found = dict(leaves(schema, root))

    def says(entry: dict[str, Any]) -> bool:
        return any(part.get("description") for part in (entry, *entry.get("anyOf", [])))

    assert [name for name, entry in found.items() if not says(entry)] == []

    def keys(table: dict[str, Any], path: str = "") -> Iterator[str]:
        for name, value in table.items():
            if isinstance(value, dict) and value:  # options of a plug-in are a leaf: only it knows them
                yield from keys(value, f"{path}{name}.")
            else:
                yield f"{path}{name}"

    assert set(found) == set(keys(msgspec.to_builtins(load(None))))


PAPER = """
uavs = 25
dt = 0.1
duration = 300.0
stop = "arrival"
[start]
centre = [150.0, 100.0]
height = 40.0
[destination]
radius = 5.0
[wind]
sigma = 0.1
mean = [1.0, -1.0]
drag = 0.1
[cost]
c1 = 0.015
c2 = 0.015
c3 = 0.005
epsilon = 1.0
beta = 1.0
[learner]
mu_h = 0.01
mu_f = 0.01
c_h = 0.5
kappa = 0.01
position_scale = 200.0
velocity_scale = 20.0
[density]
position_bandwidth = 3.0
velocity_bandwidth = 0.7
node_position_std = 5.0
node_velocity_std = 1.5
[federation]
fraction = 0.8
leader = 0
state_period = 0
[radio]
tx_power_dbm = 20.0
bandwidth_hz = 2e6
noise_psd_dbm_hz = -110.0
path_loss_exponent = 0.0
rice_xi = 6.649
rice_chi = 1.347
fading = "amplitude"
target_snr_db = 75.0
coherence_time_s = 50e-6
latency_threshold_slots = 8
bits_per_float = 32
range_m = 100.0
[vehicle]
blade_power = 0.0049
induced_power = 0.0887
parasite_drag = 0.0092
tip_speed = 15.0
induced_velocity = 1.612
[metrics]
collision_radius = 0.1
"""


def test_the_defaults_are_the_numbers_of_the_model(tmp_path: Path) -> None:
    default = msgspec.to_builtins(load(None))
    for name, value in tomllib.loads(PAPER).items():
        if isinstance(value, dict):
            assert {key: list(v) if isinstance(v := default[name][key], tuple) else v for key in value} == value
        else:
            assert default[name] == value
    assert load(None).start.spacing == math.sqrt(2)
    assert load(None).metrics.hazard_radius == math.sqrt(2) / 2
    assert load(None).participants == 20
    assert load(None).max_ticks == 3000


def test_the_paper_s_file_is_the_default_scenario() -> None:
    path = Path(__file__).parents[2] / "scenarios" / "paper.toml"
    assert load(path).sha256() == load(None).sha256()
