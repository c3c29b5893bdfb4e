"""`docs/performance.md` from a record. The numbers are this program's own, but for the sections that say otherwise."""

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

_MEMORY = """
## Where an agent's memory is

Measured once, in November 2026, in one of 25 agents in flight that was started alone (Python 3.11, NumPy 2.4, Zenoh
1.10), MiB:

| | RSS | of it its own |
|---|---:|---:|
| Zenoh's library, two thirds of it touched while a session opens | 12.4 | 0.7 |
| the interpreter and the C library | 7.8 | 1.4 |
| NumPy's libraries: its core, OpenBLAS, random, their runtimes | 9.7 | 0.4 |
| other libraries | 2.1 | 0.2 |
| Python's objects, a third of them NumPy's modules | 16.2 | 16.2 |

- Forked from a process that has loaded all that, as `meanflock run` does on Linux, an agent has 42 MiB of RSS, 7 of
  them its own, and 8 of PSS: 44 and 8.4 MB.
- The least that can join (the floor above) is three quarters of that; what is learned, known and sent is some 30 kB.
- Zenoh's queues and batches are allocated when they are used: smaller ones save nothing. Neither do fewer arenas of
  `malloc` or trimming its heap: nothing is left over there.
- NumPy would load OpenSSL and ctypes, msgspec typing_extensions where it is installed: `agent/lean.py` has them do
  without, which is worth 4.5 MiB of RSS.
- `PYTHONOPTIMIZE=2` leaves out documentation and takes 2 MiB more off each process. It is not the default: where its
  bytecode cannot be written, every start compiles.
"""

_BEFORE = """
## What it was before

Measured once, in November 2026, in turns on one machine (Intel, 2.5 GHz), nothing else running, four flights each with
25 processes:

| | ms a tick |
|---|---:|
| each agent started alone, every message through the codec | 8.5 (7.4–9.1) |
| agents forked from one, plain ticks by reflex, the world's part shortened | 5.1 (4.9–5.7) |

In one process hjb's tick fell by a fifth, mfgfl-hf's by a seventh. The ratio to the floor moved less: its clients are
forked now, too, and share the caches as agents do. [The tour](architecture.md#a-tick) says what a reflex is.

Then came rows in SIMD lanes, rounds by reflex, links that are worked out once, plain answers told by their bytes. Old
and new in turns, medians, on the same machine while its host was busy, so that everything took about twice its time:

| | turns | before | after |
|---|---:|---:|---:|
| tick in one process, 25 UAVs, mfgfl-hf, ms (fastest hundred) | 5 | 0.76 | 0.45 |
| … hjb | 5 | 2.50 | 1.46 |
| … 1000 UAVs, mfgfl-hf (fastest ten) | 3 | 13.4 | 11.8 |
| batch of 16 seeds, mfgfl-hf, µs a UAV-tick | 5 | 15.2 | 8.6 |
| what a round adds to three ticks of 25 processes, ms | 3 | 20.6 | 10.5 |
| ordinary tick of 25 processes without a recorder, ms | 3 | 8.3 | 7.2 |
| CPU of the world's main thread in it, of one agent, µs | 3 | 3429, 388 | 2344, 339 |
| tick of `meanflock run`, 25 processes, recorded, ms | 10 | 9.5 | 9.1 |

And once more: one call of the kernel from the bytes of a question to those of its answer, without frames made for
every tick. In one flight with 13 agents so and 12 that had the old way put back, twice, on a busy host: 7 and 12 %
less CPU in an agent's main thread, 6 and 7 % in its process. Without computing anything at all it would be a further
7 %: what is left is what it costs to be a process that receives and sends. Sharing the kernel's tables between agents
gained nothing.

Two things were tried and left out, because they gained nothing among 25 processes on two cores: a world that asks for
the next tick before it tells the last, and a recorder that writes in a thread of its own while one process flies (a
tenth slower: the threads share one interpreter).

Then a profiler that counts samples (`perf`) showed where the rest was: Zenoh clears as much memory as a batch may take
for every message it reads, 64 KiB by default, which for messages of 100 bytes leaves nothing else in the caches. Each
of these was measured in one flight, some agents or some ticks so and the others the old way, or in turns:

| | gained |
|---|---|
| batches of 8 KiB instead of 64 | a seventh of the CPU of a bare lockstep, floor included |
| agents answer in the thread that brings a question | 6 to 9 % of an agent's CPU, the floor's clients likewise |
| the world takes plain answers there, too, but for the last | a tenth of the world's |
| agents run as a batch job does (`SCHED_BATCH`) | a fifth of the world's, 7 % of an agent's, 11 % of a tick |
| what a plain tick works on is held by one compiled object | 4 % of an agent's |
| motion, energy and pairs compiled | 0.1 to 0.2 ms of a tick, in which everybody waited |

Of what an agent still cost beyond a bare client, computing was a quarter: without it 25 agents save 10 µs each.

The rest was Python that each process finds gone from the caches in every tick. Emptying them before a call shows what
that means: a dozen of NumPy's calls on 25 rows take 22 µs one after the other, and 113 among processes; one compiled
call 4 and 47. So the frames between a message and the kernel were taken out:

| | gained |
|---|---|
| a quiet tick is one step of Python in an agent | 8 to 12 % of its CPU, in one flight beside the old way |
| outcomes are entered, and plain answers read, by compiled calls | 150 → 57 µs, and 1.4 → 0.2 µs an answer |
| a checkpoint that keeps no more than models asks for a report | 8 ms of every hundredth tick |
| blocks of 50 rows instead of 20 for a small swarm | half of the station's CPU |
| the wind is drawn ahead, as fading was | half of the 23 µs of a tick's physics |

By then an agent cost 11 to 13 µs more than one that answers with a ready-made string and computes nothing.
Telling a tick's rows while the nodes think about the next was tried once more, by turns in one flight: nothing, since
both cores are busy anyway.

Tried again and left out: Zenoh's callbacks without a thread between (an interpreter's state is then made and thrown
away for every message, a tenth more CPU; with a state that is kept by a trick, a tenth less, as for the floor's
clients); agents pinned to cores; one queue for all priorities, or no batching: nothing.

Last the ticks of a round, and swarms of many, on another machine (AMD EPYC, two cores, whose hand-overs between threads
cost twice as much and whose arithmetic costs half):

| | before | after |
|---|---:|---:|
| what a round adds to three ticks of 25 processes, in turns, ms | 9.1–10.7 | 3.0–3.6 |
| … its tick of uploads; of the average; of the global model | 4.2–5.9; 2.4–2.7; 2.3–2.6 | 0.8–1.2; 1.8–2.0; 0.4–0.5 |
| an agent's tick that uploads, that hears the model, caches cold, µs | 133; 79 | 12; 8 |
| the world's report of 25 models, µs | 255 | 105 |
| 1000 UAVs in one process, µs a UAV-tick (fastest) | 4.1 | 2.2 |
| 4000 | 8.1 | 3.6 |
| recording 25 UAVs in one process, Rerun's share, µs a tick | 14 | 6 |

Uploads go through the world by their bytes, in the thread that brings them, and are written by the compiled object that
steps the learners. Of the 4 ms of 1000 UAVs more than half were SciPy's distances and a k-d tree.
"""

_SETTINGS = """
## Why Zenoh is set up the way it is

Measured once, in November 2026 on two shared cores, while the settings in `swarm/session.py` were chosen; this program
does not measure them again. Lockstep without learning, one 32-byte broadcast and N answers of 64 bytes, ticks a second:

| | 4 processes | 25 | 64 |
|---|---:|---:|---:|
| raw TCP, epoll | 11740 | 2604 | 867 |
| a router of its own, all clients | 2076 | 417 | 151 |
| peers by multicast | 2973 | 503 | 158 |
| the world is the router (ours) | 3408 | 581 | 213 |
| … with `lowlatency` transport | 4099 | 717 | 274 |
| … and a tuned runtime | 4866 | 920 | 326 |

- The tuned runtime (one thread a task) is worth 13–22 % and is on. Receive and transmit never share a pool: a router so
  set up waited for itself for ever, three times out of three.
- `lowlatency` is off although it is faster: messages from 50 kB on vanish without a word, and a put to a frozen
  subscriber blocks. On top of the tuned runtime it takes 8 % of their CPU off the clients and puts 40 % on the world's.
- Shared memory is off: on by default from 3 KiB, it dropped messages silently and left segments behind.
- Per agent and tick, bare Zenoh costs 136 µs of CPU and seven context switches: hand-overs between threads, not the
  interpreter lock. That is why several UAVs in one process (`--uavs-per-process`) are so much cheaper than as many
  processes.

## Peers, measured once

On the same kind of machine, one at a time, with the same 984-byte model. This program does not measure these again; its
own races with most of them are above:

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
"""


def page(record: dict[str, Any]) -> str:
    """The whole page."""
    races = record["races"]
    parts = [_BEGINNING, _machine(record)]
    parts += [_race(race) for name, race in races.items() if name != "profile"]
    if "profile" in races:
        parts.append(_profile(races["profile"]))
    return (
        "\n".join([*parts, _REPRODUCE.strip("\n"), _MEMORY.rstrip("\n"), _BEFORE.rstrip("\n"), _SETTINGS.rstrip("\n")])
        + "\n"
    )


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
        ratio = f"{figure['ratio']:.2f}"
        if figure["samples"] > 1:
            ratio += f" ({figure['ratio_min']:.2f}–{figure['ratio_max']:.2f})"
    name = figure["name"] + (f"; {figure['note']}" if figure["note"] else "")
    return f"| {name} | {figure['unit']} | {number(figure['median'])} | {spread} | {ratio} | {verdict(figure)} |"


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
