"""`docs/performance.md` from a record. The numbers are this program's own, but for the section that says otherwise."""

from typing import Any

from benchmarks.machine import BUSY_LOAD

_BEGINNING = """# Performance

Written by `python -m benchmarks`; do not edit. A time says as much about the machine as about the program, so every
race measures a floor beside it: the least that could do the same work here, in turns with it in the same run. *Ratio*
is the median over the pairs; *spread* is minimum to maximum. Targets are bounds on the median: ● met, ◐ met but for the
stretch goal, ○ not met.
"""

_REPRODUCE = """
## Reproduce it

```console
make bench                              # everything, under 6 minutes: writes this page and benchmarks/latest.json
make bench ARGS=--quick                 # under a minute, prints only
make bench ARGS="--only wire in_process"  # some races, prints only
make bench ARGS="--only scale_processes"  # 25 to 200 processes: minutes and gigabytes; only where named
make peers                              # once, before: the peers to race with, in environments of their own
```

A full run compares its ratios with the committed `benchmarks/latest.json` and says what got worse by more than 15 %
or is not measured any more; it never fails for that. Run it on a machine that does nothing else: the ratios stand some
noise, the targets don't.
"""

_ONCE = """
## Measured once

These tables are of November 2026; this program does not measure them again.

**Memory** of one of 25 agents in flight that was started alone (Python 3.11, NumPy 2.4, Zenoh 1.10), MiB. Forked from
a process that has loaded all that, as `meanflock run` does on Linux, an agent's own share is a fraction of it: see *A
process of the swarm* above. `agent/blocklist.py` keeps NumPy and msgspec from loading what no agent needs.

| | RSS | of it its own |
|---|---:|---:|
| Zenoh's library, two thirds of it touched while a session opens | 12.4 | 0.7 |
| the interpreter and the C library | 7.8 | 1.4 |
| NumPy's libraries: its core, OpenBLAS, random, their runtimes | 9.7 | 0.4 |
| other libraries | 2.1 | 0.2 |
| Python's objects, a third of them NumPy's modules | 16.2 | 16.2 |

**Zenoh's settings**, chosen in `swarm/net/session.py`: lockstep without learning, one 32-byte broadcast and N replies
of 64 bytes, ticks a second, on two shared cores. What sends has a thread of its own, since a router without one waited
for itself when a link ended, and closed others; one thread does all else, since that of the sockets had to wake the one
that read them (a tick of 25 processes took 2.96 ms, takes 2.59). Bare Zenoh costs an agent 136 µs of CPU a tick,
hand-overs between threads, which is why several UAVs in one process are so much cheaper than as many processes.

| | 4 processes | 25 | 64 |
|---|---:|---:|---:|
| raw TCP, epoll | 11740 | 2604 | 867 |
| a router of its own, all clients | 2076 | 417 | 151 |
| peers by multicast | 2973 | 503 | 158 |
| the world is the router (ours) | 3408 | 581 | 213 |
| … with `lowlatency` transport (not ours) | 4099 | 717 | 274 |
| … and a tuned runtime (ours, without `lowlatency`) | 4866 | 920 | 326 |

**NumPy among many processes**: a call that finds its code and data gone from the caches, as each of an agent does,
beside the same call in a loop, µs, on arrays of a row. So what is called once a tick is one function of the kernels.

| | cold | warm |
|---|---:|---:|
| `isfinite(a).all()` | 16.6 | 1.0 |
| `concatenate` of two tables | 11.4 | 0.6 |
| `maximum.reduce` | 8.7 | 0.7 |
| `ndarray` over a buffer | 6.4 | 0.3 |
| `empty_like` | 6.2 | 0.3 |
| a slice | 4.0 | 0.2 |
| `.copy()` | 1.5 | 0.2 |

**Peers**, one at a time, with the same 984-byte model; races with most of them are above.

| work | peer | figure |
|---|---|---|
| FedAvg round, 25 simulated clients | pfl / flwr simulation / nvflare | 13.4 ms / 205 ms / 2.5 s |
| networked round, 5 client processes | flwr deployment | 12.3 s median, 1.68 GB |
| networked round, 25 client processes | flwr deployment | second round not done after 6.5 min, 18.7 GB |
| wire bytes a client and round | flwr deployment | 4234 for 1968 of payload |
| 25-drone control step, physics only | crazyflow on a CPU | 0.49 ms |
| 25 nodes broadcasting at 10 Hz | gradysim | 25 × real time (100 nodes: 2.3 ×) |
| 25-agent flocking step | vmas, one environment | 39 ms |
| ORCA step of 25 / 250 agents | pyrvo | 22 / 335 µs |

## What did not pay

- Zenoh's `lowlatency` transport: faster, but messages from 50 kB on vanish, and a put to a frozen subscriber blocks.
- Zenoh's shared memory: it dropped messages silently and left segments behind.
- Smaller queues of Zenoh, one for all priorities, no batching; fewer arenas of `malloc`, trimming its heap: nothing.
- Zenoh's callbacks without a thread between: a tenth more CPU.
- Agents pinned to cores; kernel tables shared between agents: nothing.
- Asking for the next tick before the last one is reported: nothing, since both cores are busy anyway.
- A recorder in a thread of its own while one process flies: a tenth slower, the threads share one interpreter.
- AVX-512: quicker alone, but everything else on the core then runs at a lower clock.
- `PYTHONOPTIMIZE=2`: 2 MiB less a process, but where its bytecode cannot be written every start compiles.
- A second path for the usual messages beside the general one: faster, and more code than the path itself.
"""


def page(record: dict[str, Any]) -> str:
    """The whole page."""
    races = record["races"]
    parts = [_BEGINNING, _machine(record)]
    parts += [_race(race) for name, race in races.items() if name != "profile"]
    if "profile" in races:
        parts.append(_profile(races["profile"]))
    return "\n".join([*parts, _REPRODUCE.strip("\n"), _ONCE.rstrip("\n")]) + "\n"


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
    """Three figures, or what there is."""
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
