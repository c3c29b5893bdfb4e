"""Writes keys.md, the reference of scenario keys, from the schema and the reasons below, and keys.csv for shells."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from meanflock.cli.completion import KEYS as COMPLETED
from meanflock.results.quantities import KEY_UNITS

from meanflock.cli import catalogue
from meanflock.swarm import plugins, scenario

PAGE = Path(__file__).with_suffix(".md")
PRINTED = "printed"
SILENT = "no number"
OURS = "–"
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}

# For each key: whether the paper prints its value, and the reason for our default.
KEYS: dict[str, tuple[str, str]] = {
    "method": (PRINTED, "the paper's own proposal, MfgFL-HF"),
    "controller": (OURS, "a controller declares its own"),
    "uavs": (PRINTED, "S0, the scenario of its first figures"),
    "seed": (OURS, "any number will do; equal seeds give equal flights"),
    "dt": (PRINTED, "Euler–Maruyama: velocity first, then position with the new velocity"),
    "duration": (OURS, "in comparisons a UAV that never arrives counts with this travel time"),
    "stop": (OURS, "little of interest follows the last arrival; `duration` continues the flight"),
    "faults": (OURS, "none"),
    "obstacles": (OURS, "none"),
    "start.formation": (
        PRINTED,
        "a square whose rows are filled in order; other missions use circle, streams and waves",
    ),
    "start.centre": (PRINTED, ""),
    "start.spacing": (PRINTED, "√2 m; the paper leaves the initial velocity open, ours is 0"),
    "start.radius": (OURS, "position swaps of this size are common in work on collision avoidance"),
    "start.positions": (OURS, "for a mission of your own"),
    "start.group": (OURS, "no effect if all leave at once, except in the formation `waves`"),
    "start.interval": (PRINTED, "all UAVs leave at once"),
    "start.height": (PRINTED, "constant; it does not affect the model"),
    "destination.radius": (SILENT, "the norm is as printed, although it adds m and m/s"),
    "destination.goals": (PRINTED, "all UAVs have one destination"),
    "destination.positions": (OURS, "for a mission of your own"),
    "wind.sigma": (PRINTED, "it multiplies dW, so it is a standard deviation; the paper calls it a covariance"),
    "wind.mean": (PRINTED, ""),
    "wind.drag": (PRINTED, ""),
    "wind.common": (SILENT, "the noise of each UAV is independent of that of all others"),
    "wind.field_rms": (PRINTED, "the wind is the same everywhere"),
    "wind.field_length": (OURS, "no effect without a field"),
    "wind.field_modes": (OURS, "so many that no single wave is visible"),
    "truth.drag": (PRINTED, "the UAVs are told the truth"),
    "truth.wind": (PRINTED, "likewise"),
    "cost.c1": (PRINTED, ""),
    "cost.c2": (PRINTED, ""),
    "cost.c3": (PRINTED, ""),
    "cost.epsilon": (SILENT, "one metre, which is the order of the spacing"),
    "cost.beta": (SILENT, "the simplest exponent"),
    "cost.separation": (OURS, "the paper's cost aligns velocities and does not separate UAVs"),
    "cost.separation_range": (OURS, "five times the distance of a collision"),
    "learner.mu_h": (PRINTED, ""),
    "learner.mu_f": (PRINTED, ""),
    "learner.c_h": (PRINTED, ""),
    "learner.kappa": (
        SILENT,
        "of four values, the one whose trips last as long as in the paper; 0 only damps, 0.1 ends trips in 25 s",
    ),
    "learner.position_scale": (SILENT, "the learner diverges at once on raw metres"),
    "learner.velocity_scale": (SILENT, "the learner diverges at once on raw m/s"),
    "learner.multinomial": (
        OURS,
        "the paper prints these factors, for states in raw metres; `scenarios/paper-printed.toml` uses them",
    ),
    "learner.exchanged_rounds": (
        OURS,
        "the paper's list of parameters has 200 ticks for both models, its text 100; `paper-exchanged` exchanges them",
    ),
    "learner.act_after_s": (OURS, "UAVs act from take-off on; with 10 they drift with the wind first, as in figure 2"),
    "density.position_bandwidth": (SILENT, "the paper starts from zero weights, but nothing is learned from them"),
    "density.velocity_bandwidth": (SILENT, "likewise"),
    "density.near_samples": (SILENT, "likewise"),
    "density.box_samples": (SILENT, "likewise; the fit must also hold far from the swarm"),
    "density.ridge": (SILENT, "likewise; it keeps the fit well-conditioned"),
    "density.node_position_std": (
        SILENT,
        "a polynomial has no finite integral over all states, so φ_G is a quadrature",
    ),
    "density.node_velocity_std": (SILENT, "likewise"),
    "offline.speed_max": (SILENT, "the paper's offline path has no limits, but a vehicle has"),
    "offline.acceleration_max": (SILENT, "likewise"),
    "filter.kind": (OURS, "the paper has no collision avoidance"),
    "filter.options": (OURS, "a filter declares its own"),
    "sharing.policy": (
        OURS,
        "collision-free also if a third of the messages is lost, with a tenth of the bits sent by `tick`",
    ),
    "sharing.broadcast": (OURS, ""),
    "sharing.delta_m": (OURS, "below half of the distance that a filter maintains"),
    "sharing.velocity_delta_m_s": (OURS, ""),
    "sharing.repeats": (OURS, "enough if a third of the messages is lost"),
    "sharing.forget_s": (OURS, "longer than a series of losses, shorter than a flight across the formation"),
    "federation.period": (PRINTED, "100 for H and F, 200 for HF; one sentence of the paper has 100 for all"),
    "federation.fraction": (PRINTED, ""),
    "federation.leader": (SILENT, "any UAV will do"),
    "federation.state_period": (
        SILENT,
        "the paper does not say how often `mfg` shares states; 0 shares the initial ones only",
    ),
    "federation.aggregation": (PRINTED, "FedAvg"),
    "federation.options": (OURS, "a rule declares its own"),
    "federation.tolerance": (OURS, "a quarter of the uploads may be false"),
    "federation.byzantine_fraction": (OURS, "all uploads are true"),
    "federation.byzantine_kind": (OURS, "no effect if all uploads are true"),
    "federation.payload": (OURS, "the paper's floats; narrower ones are measured in [communication](communication.md)"),
    "federation.broadcast_payload": (OURS, "likewise"),
    "federation.error_feedback": (OURS, "without it rounding errors add up; see [communication](communication.md)"),
    "federation.fragment": (
        OURS,
        "the paper's models fit into one message; [federation](federation.md) says what longer ones do",
    ),
    "federation.deadline": (OURS, "on the paper's radio an upload takes 0.4 ms at most, so none is late"),
    "federation.upload_threshold": (OURS, "the paper's UAVs upload in every round"),
    "federation.clusters": (OURS, "one leader for all UAVs; [scaling](scaling.md) says what clusters cost and save"),
    "federation.topology": (OURS, "one leader averages all models"),
    "federation.range_m": (PRINTED, "the paper's uploads and global models reach any distance"),
    "radio.tx_power_dbm": (PRINTED, ""),
    "radio.bandwidth_hz": (PRINTED, ""),
    "radio.noise_psd_dbm_hz": (PRINTED, ""),
    "radio.path_loss_exponent": (
        PRINTED,
        "with α = 0 all links are alike, whatever their length. The paper's equations ask for α ≥ 2, its list of "
        "parameters has 0",
    ),
    "radio.rice_xi": (PRINTED, ""),
    "radio.rice_chi": (PRINTED, ""),
    "radio.fading": (PRINTED, "the paper multiplies the SNR by an amplitude; `power` squares it"),
    "radio.target_snr_db": (
        SILENT,
        "printed power, noise and fading give a median SNR of 75.3 dB at every distance, because α = 0; with a target "
        "near this median the radio loses long models sometimes and short ones rarely",
    ),
    "radio.coherence_time_s": (SILENT, "chosen together with `radio.target_snr_db`"),
    "radio.latency_threshold_slots": (SILENT, "likewise"),
    "radio.bits_per_float": (SILENT, "b in the paper's formula of the payload"),
    "radio.range_m": (PRINTED, "the reach of the states that `hjb` sends"),
    "radio.plausible_speed": (
        OURS,
        "far above the speeds flown here; [robustness](robustness.md#false-states) measures false states below it",
    ),
    "radio.model": (PRINTED, ""),
    "radio.options": (OURS, "a channel declares its own"),
    "vehicle.model": (PRINTED, "double integrator in wind, power of a rotary wing"),
    "vehicle.options": (OURS, "a vehicle declares its own"),
    "vehicle.acceleration_max": (PRINTED, "the paper's vehicle has no limit; the leaderboard flies at 6 m/s²"),
    "vehicle.blade_power": (PRINTED, "a vehicle of about five grams, which hovers with 0.094 W"),
    "vehicle.induced_power": (PRINTED, "likewise"),
    "vehicle.power_speed": (
        PRINTED,
        "with `ground`, as printed, drifting with the wind is free; with `air` it costs power",
    ),
    "vehicle.parasite_drag": (PRINTED, "likewise"),
    "vehicle.tip_speed": (PRINTED, "likewise"),
    "vehicle.induced_velocity": (PRINTED, "likewise"),
    "energy.radio_W": (OURS, "the paper counts the energy of motion only"),
    "energy.step_J": (OURS, "likewise"),
    "metrics.collision_radius": (PRINTED, "a pair counts once, while both are on the way"),
    "metrics.hazard_radius": (PRINTED, "√2/2 m"),
    "pace.slow_s": (OURS, "far above what a healthy node takes"),
    "pace.slow_factor": (OURS, "if all nodes are slow, no node is to blame"),
    "pace.slow_ticks": (OURS, "spares a node that is slow now and then"),
    "pace.wait_share": (
        OURS,
        "one agent slows a flight by a quarter at most; an agent may always cost its share of the UAVs",
    ),
    "pace.wait_window_s": (OURS, "longer than any pause of a healthy machine"),
    "pace.rejoins": (OURS, "as often as `meanflock run` restarts a process"),
    "pace.rejoin_ticks": (OURS, "a minute of flight"),
}


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
        "## [[obstacles]]",
        "",
        schema["Obstacle"]["description"],
        "",
        "| key | what | unit | bounds |",
        "|---|---|---|---|",
        "| `centre` | its centre | m | two numbers |",
        "| `radius` | its radius | m | > 0 |",
        "",
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
        lines.append(f"| `{kind}` | {schema[fault]['description']} | {'; '.join(keys)} |")
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
        if key not in ("controller", "faults", "obstacles") and name != "options":
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


def _table(schema: dict[str, Any], table: str, prefix: str) -> Iterator[str]:
    yield "| key | what | unit | bounds | default | the paper | why |"
    yield "|---|---|---|---|---|---|---|"
    for name, key in schema[table]["properties"].items():
        if "$ref" in key:
            continue
        path = prefix + name
        paper, reason = KEYS[path]
        about = _description(key)
        unit = KEY_UNITS.get(path, "")
        for suffix in (f", {unit}", f", {unit.replace(', ', ' and ')}"):
            about = about.removesuffix(suffix) if unit else about
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
