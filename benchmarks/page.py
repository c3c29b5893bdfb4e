"""Writes the measurements of a record into `docs/performance.md`."""

from typing import Any

from benchmarks.machine import BUSY_LOAD
from meanflock.studies.markdown import replaced

BEGIN, END = "<!-- measured -->", "<!-- end -->"


def page(record: dict[str, Any], text: str) -> str:
    """The page `text` with these measurements."""
    races = record["races"]
    parts = [_machine(record)]
    parts += [_race(race) for name, race in races.items() if name != "profile"]
    if "profile" in races:
        parts.append(_profile(races["profile"]))
    return replaced(text, BEGIN, END, ["", *parts])


def _machine(record: dict[str, Any]) -> str:
    machine, versions = record["machine"], record["versions"]
    busy = (
        f" **It was busy: load {machine['load_before']} before the start.**"
        if machine["load_before"] > BUSY_LOAD
        else ""
    )
    quick = " **Some of it from a quick run, with few samples.**" if _has_quick(record) else ""
    installed = ", ".join(f"{name} {version}" for name, version in versions.items())
    return (
        f"Measured {record['date']} in {record['seconds']:.0f} s on {machine['cpu']}, {machine['cores']} cores, "
        f"{machine['memory_GiB']} GiB, {machine['system']}.{busy}{quick} {installed[0].upper()}{installed[1:]}.\n"
    )


def _has_quick(record: dict[str, Any]) -> bool:
    return any(race["effort"] == "quick" for race in record["races"].values())


def _race(race: dict[str, Any]) -> str:
    lines = [f"## {race['title']}", "", race["about"], ""]
    if race["error"]:
        return "\n".join([*lines, f"Not available: {race['error']}", ""])
    lines += ["| | unit | median | spread | ratio to its floor | target |", "|---|---|---:|---:|---:|---|"]
    lines += [_row(figure) for figure in race["figures"]]
    lines += ["", *[f"- {note}" for note in race["notes"]], *([""] if race["notes"] else [])]
    return "\n".join(lines)


def _row(figure: dict[str, Any]) -> str:
    spread = f"{number(figure['min'])}–{number(figure['max'])}" if figure["samples"] > 1 else ""
    ratio = ""
    if figure["ratio"] is not None:
        ratio = _ratio(figure["ratio"])
        if figure["samples"] > 1:
            ratio += f" ({_ratio(figure['ratio_min'])}–{_ratio(figure['ratio_max'])})"
    name = figure["name"] + (f"; {figure['note']}" if figure["note"] else "")
    return f"| {name} | {figure['unit']} | {number(figure['median'])} | {spread} | {ratio} | {verdict(figure)} |"


def _ratio(value: float) -> str:
    """Two decimals, or two figures of what is less than a tenth."""
    return f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"


def number(value: float | None) -> str:
    """A number with three digits."""
    if value is None:
        return "–"
    if value == int(value) and abs(value) < 1e6:
        return str(int(value))
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def verdict(figure: dict[str, Any]) -> str:
    """The bounds of a figure and whether they are met."""
    return "; ".join(
        filter(
            None,
            [
                _bound(figure["median"], figure["target"], figure["stretch"], figure["better"], figure["unit"]),
                _bound(figure["ratio"], figure["ratio_target"], figure["ratio_stretch"], "lower", "× its floor"),
            ],
        )
    )


def _bound(value: float | None, target: float | None, stretch: float | None, better: str, unit: str) -> str:
    if target is None and stretch is None:
        return ""
    sign = "≥" if better == "higher" else "≤"

    def met(bound: float | None) -> bool | None:
        if bound is None or value is None:
            return None
        return value >= bound if better == "higher" else value <= bound

    words = []
    if target is not None:
        words.append(f"{sign} {number(target)} {unit}")
    if stretch is not None:
        words.append(f"stretch {sign} {number(stretch)}" + (f" {unit}" if target is None else ""))
    missed = [bound for bound in (target, stretch) if met(bound) is False]
    mark = "○" if target in missed or (target is None and missed) else "◐" if missed else "●"
    return f"{mark} {', '.join(words)}"


def _profile(race: dict[str, Any]) -> str:
    lines = [f"## {race['title']}", "", race["about"], ""]
    if race["error"]:
        return "\n".join([*lines, f"Not available: {race['error']}", ""])
    inside, world, agent = (race["details"][name] for name in ("in_process", "world", "agent"))
    lines += [
        f"**In one process**, {inside['tick_us']:.0f} µs a tick "
        f"({inside['unprofiled_tick_us']:.0f} µs without the wraps):",
        "",
        *_parts(inside["parts"], "wall µs/tick"),
        f"**The world's process** among 25 agents, {world['tick_us']:.0f} µs a tick, "
        f"of which its threads compute {world['cpu_us']:.0f} µs:",
        "",
        *_parts(world["parts"], "wall µs/tick"),
        f"**One agent's process**, {agent['cpu_us']:.0f} µs of CPU a tick "
        f"and {agent['switches']:.1f} context switches:",
        "",
        *_parts(agent["parts"], "CPU µs/tick"),
    ]
    cores_ms = (agent["cpu_us"] * 25 + world["cpu_us"]) / 1e3
    lines += [
        f"25 agents and the world need {cores_ms:.2f} ms of CPU a tick between them; divided by the number of cores, "
        "that is the tick no scheduling can beat.",
        "",
        *[f"{note}.\n" for note in race["notes"]],
    ]
    return "\n".join(lines)


def _parts(parts: list[dict[str, Any]], unit: str) -> list[str]:
    rows = [f"| part | {unit} | share | calls |", "|---|---:|---:|---:|"]
    for part in parts:
        calls = "" if part["calls"] is None else f"{part['calls']:.1f}"
        rows.append(f"| {part['part']} | {part['us']:.1f} | {part['share'] * 100:.1f} % | {calls} |")
    return [*rows, ""]
