"""Progress bar of a flight on standard error, and the tables of its summary."""

from collections.abc import Mapping
from types import TracebackType
from typing import Any

from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table

from meanflock.channel.meter import TRAFFIC
from meanflock.results.quantities import ARRIVED, COUNTS, FIELDS, OUTAGES, PAYLOAD
from meanflock.results.series import BITS_SENT, COLUMN
from meanflock.swarm.scenario import Scenario, Until
from meanflock.swarm.wire.messages import Telemetry

_BAR, _BAR_NARROW = 24, 10  # columns
_UPLOADS = {"uploads_silent": "not sent", "uploads_late": "late", "uploads_refused": "refused"}  # of the summary
_WIDE = 120  # columns of a terminal with room for everything


class FlightProgress:
    """Progress bar fed with telemetry; a `Sink`. In a narrow terminal it leaves columns out."""

    def __init__(self, scenario: Scenario, quiet: bool, console: Console | None = None) -> None:
        """`console`: where to show it; None: standard error, if that is a terminal."""
        self._scenario = scenario
        self._console = console or Console(stderr=True)
        bar = _BAR if self._console.width >= _WIDE else _BAR_NARROW
        whole = Column(no_wrap=True, min_width=len(f"{scenario.max_ticks}/{scenario.max_ticks}"))
        self._bar = Progress(
            TextColumn("[bold]{task.description}", table_column=Column(no_wrap=True)),
            BarColumn(bar_width=bar),
            MofNCompleteColumn(table_column=whole),
            TextColumn("ticks", table_column=Column(no_wrap=True, min_width=len("ticks"))),
            TextColumn("{task.fields[detail]}", table_column=Column(no_wrap=True)),
            TimeRemainingColumn(compact=True, table_column=Column(no_wrap=True, min_width=len("00:00"))),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
            transient=True,
        )
        # flying, bar, n/of, ticks, detail and time left, with a column between each two
        fixed = len("flying") + bar + 2 * len(str(scenario.max_ticks)) + 1 + len("ticks") + len("0:00:00") + 5
        self._room = self._console.width - fixed
        self._first: tuple[float, float] | None = None  # when the first ticks came, and to which simulated time, s
        self._task = self._bar.add_task("starting", total=scenario.max_ticks, detail="")

    def __enter__(self) -> "FlightProgress":
        self._bar.start()
        return self

    def __exit__(self, _t: type[BaseException] | None, _e: BaseException | None, _b: TracebackType | None) -> None:
        self._bar.stop()

    def give_up(self) -> None:
        """Restore the cursor of the terminal, before the process ends at once."""
        if not self._bar.disable:
            self._console.show_cursor()

    def say(self, text: str) -> None:
        """Show a text before the first tick."""
        self._bar.update(self._task, description=text)

    def write(self, block: Telemetry) -> None:
        """Show the last row of a block."""
        tick = block.first_tick + len(block.states) - 1
        row = block.swarm[-1]
        now = self._bar.tasks[0].elapsed or 0.0
        seconds = tick * self._scenario.dt
        self._first = self._first or (now, seconds)  # start-up is no part of the flight
        elapsed, flown = now - self._first[0], seconds - self._first[1]
        bits = row[BITS_SENT].sum()
        parts = [
            f"{seconds:.1f} s",
            f"×{flown / elapsed:.0f}" if flown and elapsed else "×–",
            f"arrived {row[COLUMN['arrived']]:.0f}/{self._scenario.uavs}",
            f"{bits / 1e6:.2f} Mbit",
            f"outages {row[COLUMN['outages']]:.0f}",
        ]
        if held := row[COLUMN["held_commands"]]:
            parts.insert(3, f"held {held:.0f} in {row[COLUMN['deadline_misses']]:.0f} late ticks")
        detail = parts[0]
        for part in parts[1:]:
            if len(detail) + 2 + len(part) > self._room:
                break
            detail += f"  {part}"
        self._bar.update(self._task, completed=tick, description="flying", detail=detail)


def summary_table(summary: dict[str, object], until: str | None) -> Table:
    """Table of the summary for a terminal.

    `until`: the key of the scenario.
    """
    table = Table(title=f"{summary['method']}, {summary['uavs']} UAVs, seed {summary['seed']}", show_header=False)
    table.add_column(style="bold")
    table.add_column(justify="right")
    table.add_column()
    bits, radio = summary["payload_bits"], summary["radio"]
    assert isinstance(bits, dict)
    assert isinstance(radio, dict)

    def shown(value: object, digits: int = 2) -> str:
        return "–" if value is None else f"{value:,.{digits}f}" if isinstance(value, float) else f"{value:,}"

    def add(name: str, value: object, unit: str, digits: int = 2) -> None:
        table.add_row(name, shown(value, digits), unit)

    if summary["nodes_lost"]:
        rejoined = f"{summary['nodes_rejoined']} rejoined"
        if summary["nodes_rejoined"]:
            rejoined += ": agents among them began anew, without what they had learned"
        table.add_row("processes lost", f"{summary['nodes_lost']}", rejoined)
    table.add_row(ARRIVED.name, f"{summary['arrived']} of {summary['uavs']}", f"{summary['lost']} lost")

    def quantity(field: str, statistic: str, digits: int) -> None:
        known = FIELDS[field]
        add(f"{known.name}, {statistic}" if statistic else known.name, summary[field], known.qualified_unit, digits)

    quantity("t_avg_s", "mean", 1)
    quantity("t_max_s", "longest", 1)
    quantity("energy_mean_J", "mean", 2)
    quantity("phi_A", "", 3)
    quantity("phi_C_distinct", "", 5)
    quantity("collisions", "", 0)
    for field in COUNTS:
        if summary.get(field) and field != "lost":
            quantity(field, "", 0)
    quantity("speed_max_m_s", "highest", 1)
    quantity("distance_mean_m", "mean", 0)
    for name in TRAFFIC.values():
        if bits[name]:
            add(f"{name} {PAYLOAD.name}", bits[name], PAYLOAD.unit)
    add("on the wire", summary["wire_bytes"], "bytes")
    add(OUTAGES.name, radio["outages"], f"of {shown(radio['sent'])} {OUTAGES.unit}")
    if radio["outage_rate"] is not None:
        theory = radio["outage_rate_theory"]  # None if the channel has no closed forms
        add(
            "outage rate", radio["outage_rate"] * 100, "%" if theory is None else f"%, closed form {theory * 100:.2f} %"
        )
    if radio["latency_slots_mean"] is not None:
        theory = radio["latency_slots_mean_theory"]
        add(
            "latency, mean",
            radio["latency_slots_mean"],
            "slots" if theory is None else f"slots, closed form {theory:.2f}",
        )
    add("rounds", summary["rounds"], f"{void} more were void" if (void := summary["rounds_void"]) else "")
    if until is not None and isinstance(target := summary.get("until"), dict):
        cost = f"in round {target['round']}, after {target['time_s']:g} s" if target["reached"] else ""
        table.add_row(str(Until.of_text(until)), "reached" if cost else "not reached", cost)
    for field, name in _UPLOADS.items():
        if summary[field]:
            add(name, summary[field], "uploads")
    if summary["rounds_isolated"]:
        add("isolated UAVs", summary["rounds_isolated"], "summed over rounds")
    add("simulated time", summary["sim_time_s"], "s", 1)
    add("real-time factor", summary["real_time_factor"], "×", 1)
    if (world_s := summary.get("world_time_s")) is not None:
        add("time of the world", world_s, f"of {shown(summary['wall_time_s'])} s")
    if isinstance(realtime := summary["realtime"], dict):
        jitter = realtime["tick_start_jitter_ms"]
        add("commands held", summary["held_commands"], "came late", 0)
        add("deadline misses", realtime["deadline_misses"], f"of {shown(summary['ticks'])} ticks", 0)
        add("tick starts late by, mean", jitter["mean"], "ms")
        add("tick starts late by, 99 %", jitter["p99"], "ms")
        add("tick starts late by, at most", jitter["max"], "ms")
    if isinstance(steered := summary["steered"], dict):
        remark = "" if steered["replayable"] else "so the flight cannot be replayed"
        add("commands steered", steered["uav_ticks"], remark, 0)
    return table


_OF_GROUP = {  # fields of a group: heading and digits
    "uavs": ("UAVs", 0),
    "arrived": ("arrived", 0),
    "lost": ("lost", 0),
    "landed": ("landed", 0),
    "t_avg_s": ("travel\ntime\n(s)", 1),
    "energy_mean_J": ("energy\nuntil\narrival\n(J)", 2),
    "collisions": ("colli-\nsions", 0),
    "airtime_s": ("airtime\n(s)", 2),
}
_GROUPS = (
    "Travel time: mean of the UAVs that arrived. Energy: mean, until the end of the flight for a UAV that never "
    "arrives. Airtime: how long its UAVs sent. A collision of UAVs of two groups counts in both."
)


def groups_table(groups: Mapping[str, Mapping[str, Any]]) -> Table:
    """Table of the groups of a summary in 80 columns; `lost` and `landed` only if any UAV is."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False, caption=_GROUPS)
    table.caption_justify = "left"
    table.add_column("group", overflow="fold")
    table.add_column("method", overflow="fold")
    fields = [name for name in _OF_GROUP if name not in ("lost", "landed") or any(g[name] for g in groups.values())]
    for name in fields:
        table.add_column(_OF_GROUP[name][0], justify="right", no_wrap=True)
    for name, group in groups.items():
        numbers = ("–" if group[each] is None else f"{group[each]:,.{_OF_GROUP[each][1]}f}" for each in fields)
        table.add_row(name, group["method"], *numbers)
    return table
