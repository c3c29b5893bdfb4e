"""Writes keys.md, the key reference, from the schema of a scenario and from what is known of every key here."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from meanflock.groundstation.results.quantities import KEY_UNITS
from meanflock.swarm import scenario

PAGE = Path(__file__).with_suffix(".md")
PRINTED, SILENT, OURS = "printed", "no number", "–"
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}

# Of every key: whether the paper prints its value, and why it has the one it has.
KEYS: dict[str, tuple[str, str]] = {
    "method": (PRINTED, "the paper's own proposal, MfgFL-HF"),
    "controller": (OURS, "a controller declares its own"),
    "uavs": (PRINTED, "S0, the scenario of its first figures"),
    "seed": (OURS, "every number gives another flight; equal ones give equal flights"),
    "dt": (PRINTED, "Euler–Maruyama: velocity first, then position with the new velocity"),
    "duration": (OURS, "where methods are compared, a UAV that never arrives counts with it"),
    "stop": (OURS, "few questions are about what follows the last arrival; `duration` flies on"),
    "faults": (OURS, "none"),
    "obstacles": (OURS, "none"),
    "start.formation": (PRINTED, "a square, rows filled in order; circle, streams and waves are of other missions"),
    "start.centre": (PRINTED, ""),
    "start.spacing": (PRINTED, "√2 m; at rest, which it leaves open"),
    "start.radius": (OURS, "swaps of this size are common in work on collision avoidance"),
    "start.positions": (OURS, "for a mission of one's own"),
    "start.group": (OURS, "without effect where all leave at once, but on the formation waves"),
    "start.interval": (PRINTED, "all leave at once"),
    "start.height": (PRINTED, "constant, and without effect on the model"),
    "destination.radius": (SILENT, "the norm is kept as printed, although it adds m to m/s"),
    "destination.goals": (PRINTED, "one destination for all"),
    "destination.positions": (OURS, "for a mission of one's own"),
    "wind.sigma": (PRINTED, "multiplies dW, so it is a standard deviation, which the paper calls a covariance"),
    "wind.mean": (PRINTED, ""),
    "wind.drag": (PRINTED, ""),
    "wind.field_rms": (PRINTED, "everywhere the same wind"),
    "wind.field_length": (OURS, "without effect where there is no field"),
    "wind.field_modes": (OURS, "enough that no single wave is seen"),
    "truth.drag": (PRINTED, "the UAVs are told the truth"),
    "truth.wind": (PRINTED, "likewise"),
    "cost.c1": (PRINTED, ""),
    "cost.c2": (PRINTED, ""),
    "cost.c3": (PRINTED, ""),
    "cost.epsilon": (SILENT, "one metre, the order of the spacing"),
    "cost.beta": (SILENT, "the simplest exponent"),
    "cost.separation": (OURS, "the paper's cost aligns velocities and separates nobody"),
    "cost.separation_range": (OURS, "five times the distance that counts as a collision"),
    "learner.mu_h": (PRINTED, ""),
    "learner.mu_f": (PRINTED, ""),
    "learner.c_h": (PRINTED, ""),
    "learner.kappa": (
        SILENT,
        "chosen of four values because trips then last as long as in the paper; 0 only damps, 0.1 ends trips in 25 s",
    ),
    "learner.position_scale": (SILENT, "in raw metres the learner diverges at once"),
    "learner.velocity_scale": (SILENT, "in raw m/s the learner diverges at once"),
    "learner.multinomial": (
        OURS,
        "the paper prints them, for states in raw metres; `scenarios/paper-printed.toml` keeps them",
    ),
    "density.position_bandwidth": (SILENT, "the paper starts from zero weights, from which nothing is learned"),
    "density.velocity_bandwidth": (SILENT, "likewise"),
    "density.near_samples": (SILENT, "likewise"),
    "density.box_samples": (SILENT, "likewise: the fit must hold away from the swarm, too"),
    "density.ridge": (SILENT, "likewise: keeps the fit well-conditioned"),
    "density.node_position_std": (SILENT, "a polynomial has no integral over all states, so φ_G is a quadrature"),
    "density.node_velocity_std": (SILENT, "likewise"),
    "offline.speed_max": (SILENT, "the paper's offline path has no limits; a craft has"),
    "offline.acceleration_max": (SILENT, "likewise"),
    "filter.kind": (OURS, "the paper has no collision avoidance"),
    "filter.options": (OURS, "a filter declares its own"),
    "filter.broadcast": (OURS, "a fiftieth of the bits of a state a tick, and no collisions either"),
    "filter.delta_m": (OURS, "below half of the distance the filter keeps"),
    "filter.velocity_delta_m_s": (OURS, "none: a velocity that is off makes the position off soon enough"),
    "filter.repeats": (OURS, "enough where 3 % of messages are lost; 2 to 4 where more are"),
    "filter.forget_s": (OURS, "longer than losses in a row, shorter than a way across the formation"),
    "federation.period": (PRINTED, "100 for H and F, 200 for HF; the text has 100 for all once"),
    "federation.fraction": (PRINTED, ""),
    "federation.leader": (SILENT, "any will do"),
    "federation.state_period": (SILENT, "mfg shares states, but not how often; 0 is the initial ones only"),
    "federation.aggregation": (PRINTED, "FedAvg"),
    "federation.options": (OURS, "a rule declares its own"),
    "federation.tolerance": (OURS, "a quarter of the uploads may be false"),
    "federation.byzantine_fraction": (OURS, "nobody lies"),
    "federation.byzantine_kind": (OURS, "without effect where nobody lies"),
    "federation.payload": (OURS, "the paper's floats; narrower ones are measured in [communication](communication.md)"),
    "federation.broadcast_payload": (OURS, "likewise"),
    "federation.error_feedback": (OURS, "without it rounding adds up; see [communication](communication.md)"),
    "federation.clusters": (OURS, "one leader for all; what heads cost and save is in [scaling](scaling.md)"),
    "federation.topology": (OURS, "one leader; K > 1 clusters mean `clusters`"),
    "federation.range_m": (PRINTED, "the paper's uploads and global models reach any distance"),
    "radio.tx_power_dbm": (PRINTED, ""),
    "radio.bandwidth_hz": (PRINTED, ""),
    "radio.noise_psd_dbm_hz": (PRINTED, ""),
    "radio.path_loss_exponent": (PRINTED, "distance does not matter to the radio; its model asks for α ≥ 2"),
    "radio.rice_xi": (PRINTED, ""),
    "radio.rice_chi": (PRINTED, ""),
    "radio.fading": (PRINTED, "an amplitude multiplies the SNR; `power` has its square"),
    "radio.target_snr_db": (
        SILENT,
        "near the median SNR, so that large models fail now and then and small ones rarely",
    ),
    "radio.coherence_time_s": (SILENT, "likewise"),
    "radio.latency_threshold_slots": (SILENT, "likewise"),
    "radio.bits_per_float": (SILENT, "b in the paper's formula of the payload"),
    "radio.range_m": (PRINTED, "how far hjb's states reach"),
    "radio.plausible_speed": (
        OURS,
        "far above the speeds flown here; [robustness](robustness.md#false-states) has what lies below it do",
    ),
    "radio.model": (PRINTED, ""),
    "radio.options": (OURS, "a channel declares its own"),
    "vehicle.model": (PRINTED, "double integrator in wind, power of a rotary wing"),
    "vehicle.options": (OURS, "a vehicle declares its own"),
    "vehicle.blade_power": (PRINTED, "a craft of some five grams: it hovers with 0.094 W"),
    "vehicle.induced_power": (PRINTED, "likewise"),
    "vehicle.power_speed": (PRINTED, "as printed, the wind carries for nothing; `air` has it cost"),
    "vehicle.parasite_drag": (PRINTED, "likewise"),
    "vehicle.tip_speed": (PRINTED, "likewise"),
    "vehicle.induced_velocity": (PRINTED, "likewise"),
    "metrics.collision_radius": (PRINTED, "a pair counts once, while both are on the way"),
    "metrics.hazard_radius": (PRINTED, "√2/2 m"),
    "pace.slow_s": (OURS, "far above what a healthy node takes"),
    "pace.slow_factor": (OURS, "where all nodes are slow, none is"),
    "pace.slow_ticks": (OURS, "spares who is slow now and then"),
    "pace.wait_share": (
        OURS,
        "a flight is slowed down by a quarter at most; an agent with more of the UAVs may cost that",
    ),
    "pace.wait_window_s": (OURS, "longer than any hiccup of a healthy machine"),
    "pace.rejoins": (OURS, "as often as a launcher starts a process again"),
    "pace.rejoin_ticks": (OURS, "a minute of flight"),
}


def page() -> str:
    """The whole page."""
    schema = scenario.schema()["$defs"]
    lines = [
        "# Scenario keys",
        "",
        "Written by `python docs/keys.py`; a test compares it with the code. A scenario is a TOML file; what it leaves",
        "out has the default. Set a key for one flight with `--set wind.sigma=0.3`, or in Python with",
        '`mf.fly("paper", **{"wind.sigma": 0.3})`. A wrong key, type or value is refused before anything flies.',
        "",
        f"*The paper*: **{PRINTED}**, the default is the value the paper prints; **{SILENT}**, the paper has",
        f"the quantity but no value; **{OURS}**, the paper has no such quantity. *Why*: the default's reason.",
        "",
        "## Top level",
        "",
        "These stand before the first table.",
        "",
        *_table(schema, "Scenario", ""),
    ]
    for name, key in schema["Scenario"]["properties"].items():
        if "$ref" in key:
            of = key["$ref"].rpartition("/")[2]
            lines += ["", f"## [{name}]", "", schema[of]["description"], "", *_table(schema, of, f"{name}.")]
    lines += [
        "",
        "## [[obstacles]]",
        "",
        schema["Obstacle"]["description"],
        "",
        "| key | what | unit | bounds |",
        "|---|---|---|---|",
        "| `centre` | where it is | m | two numbers |",
        "| `radius` | from there to its edge | m | > 0 |",
        "",
        "## [[faults]]",
        "",
        "What goes wrong, with whom, when and for how long; in simulated time; as many as are wanted.",
        "A fault begins at `tick` or at `time_s`; one that begins after `duration` is warned of. With",
        "`harmless = true` it declares that the flight is the same without it.",
        "A file that holds faults alone is flown with `--faults FILE`.",
        "",
        "| kind | what it does | keys |",
        "|---|---|---|",
    ]
    for of in _faults(schema):
        own = schema[of]["properties"]
        keys = [
            f"`{name}`{_meaning(key)}"
            for name, key in own.items()
            if name not in ("kind", "tick", "time_s", "harmless")
        ]
        kind = own["kind"]["enum"][0]
        lines.append(f"| `{kind}` | {schema[of]['description']} | {'; '.join(keys)} |")
    return "\n".join(lines) + "\n"


def keys() -> list[str]:
    """Every key, dotted, but those within a fault."""
    schema = scenario.schema()["$defs"]
    found = []
    for name, key in schema["Scenario"]["properties"].items():
        inner = schema[key["$ref"].rpartition("/")[2]]["properties"] if "$ref" in key else None
        found += [name] if inner is None else [f"{name}.{one}" for one in inner]
    return found


def _faults(schema: dict[str, Any]) -> Iterator[str]:
    for item in schema["Scenario"]["properties"]["faults"]["items"]["anyOf"]:
        yield item["$ref"].rpartition("/")[2]


def _table(schema: dict[str, Any], of: str, prefix: str) -> Iterator[str]:
    yield "| key | what | unit | bounds | default | the paper | why |"
    yield "|---|---|---|---|---|---|---|"
    for name, key in schema[of]["properties"].items():
        if "$ref" in key:
            continue
        path = prefix + name
        paper, why = KEYS[path]
        about = _typed(key).get("description", "")
        unit = KEY_UNITS.get(path, "")
        for suffix in (f", {unit}", f", {unit.replace(', ', ' and ')}"):
            about = about.removesuffix(suffix) if unit else about
        cells = (f"`{path}`", about, unit, _bounds(_typed(key)), _default(key), paper, why)
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _typed(key: dict[str, Any]) -> dict[str, Any]:
    """The key itself, or the part of it that is not null."""
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
    about = _typed(key).get("description", "")
    return f": {about}" if about else ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
