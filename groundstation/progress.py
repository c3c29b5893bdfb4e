"""What a person sees while a swarm flies: one line that moves, on stderr."""

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from channel.meter import TRAFFIC
from swarm.messages import SWARM_COLUMNS, Telemetry
from swarm.scenario import Scenario

_COLUMN = {name: k for k, name in enumerate(SWARM_COLUMNS)}


class FlightProgress:
    """A progress bar fed with telemetry; a `Sink`."""

    def __init__(self, scenario: Scenario, quiet: bool) -> None:
        self._scenario = scenario
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("ticks"),
            TextColumn("{task.fields[detail]}"),
            TimeRemainingColumn(compact=True),
            console=Console(stderr=True),
            disable=quiet,
            transient=True,
        )
        self._task = self._bar.add_task("starting", total=scenario.max_ticks, detail="")

    def __enter__(self) -> "FlightProgress":
        self._bar.start()
        return self

    def __exit__(self, _t: type[BaseException] | None, _e: BaseException | None, _b: TracebackType | None) -> None:
        self._bar.stop()

    def say(self, text: str) -> None:
        """What is going on before the first tick."""
        self._bar.update(self._task, description=text)

    def write(self, block: Telemetry) -> None:
        """Shows the last row of a block."""
        tick = block.first_tick + len(block.states) - 1
        row = block.swarm[-1]
        elapsed = self._bar.tasks[0].elapsed or 0.0
        seconds = tick * self._scenario.dt
        bits = sum(row[_COLUMN[f"{name}_bits"]] for name in TRAFFIC.values())
        detail = (
            f"{seconds:6.1f} s  ×{seconds / elapsed if elapsed else 0:.0f} real time  "
            f"arrived {row[_COLUMN['arrived']]:.0f}/{self._scenario.uavs}  {bits / 1e6:.2f} Mbit  "
            f"outages {row[_COLUMN['outages']]:.0f}"
        )
        if held := row[_COLUMN["held_commands"]]:
            detail += f"  held {held:.0f} in {row[_COLUMN['deadline_misses']]:.0f} late ticks"
        self._bar.update(self._task, completed=tick, description="flying", detail=detail)


def summary_table(summary: dict[str, object]) -> Table:
    """The summary as a person reads it."""
    table = Table(title=f"{summary['method']}, {summary['uavs']} UAVs, seed {summary['seed']}", show_header=False)
    table.add_column(style="bold")
    table.add_column(justify="right")
    table.add_column()
    bits, radio = summary["payload_bits"], summary["radio"]
    assert isinstance(bits, dict)
    assert isinstance(radio, dict)

    def add(name: str, value: object, unit: str, digits: int = 2) -> None:
        shown = "–" if value is None else f"{value:,.{digits}f}" if isinstance(value, float) else f"{value:,}"
        table.add_row(name, shown, unit)

    table.add_row("arrived", f"{summary['arrived']} of {summary['uavs']}", f"{summary['lost']} lost")
    if summary["nodes_lost"]:
        table.add_row("processes lost", f"{summary['nodes_lost']}", f"{summary['nodes_rejoined']} rejoined")
    add("travel time, mean", summary["t_avg_s"], "s", 1)
    add("travel time, longest", summary["t_max_s"], "s", 1)
    add("motion energy, mean", summary["energy_mean_J"], "J until own arrival")
    add("alignment φ_A", summary["phi_A"], "m/s", 3)
    add("collision risk φ_C, distinct pairs", summary["phi_C_distinct"], "", 5)
    add("collisions", summary["collisions"], "pairs", 0)
    add("speed, highest", summary["speed_max_m_s"], "m/s", 1)
    add("distance, mean", summary["distance_mean_m"], "m", 0)
    for name in TRAFFIC.values():
        if bits[name]:
            add(f"{name} payload", bits[name], "bits")
    add("on the wire", summary["wire_bytes"], "bytes")
    add("radio links in outage", radio["outages"], f"of {radio['sent']:,}")
    if radio["outage_rate"] is not None:
        add(
            "outage rate",
            radio["outage_rate"] * 100,
            f"%, closed form {radio['outage_rate_theory'] * 100:.2f} %",
        )
    if radio["latency_slots_mean"] is not None:
        theory = radio["latency_slots_mean_theory"]
        add("latency, mean", radio["latency_slots_mean"], f"slots, closed form {theory:.2f}")
    add("rounds", summary["rounds"], "")
    add("simulated time", summary["sim_time_s"], "s", 1)
    add("real-time factor", summary["real_time_factor"], "×", 1)
    if isinstance(kept := summary["realtime"], dict):
        jitter = kept["tick_start_jitter_ms"]
        add("commands held", summary["held_commands"], "came late", 0)
        add("deadline misses", kept["deadline_misses"], f"of {summary['ticks']:,} ticks", 0)
        add("tick starts late by, mean", jitter["mean"], "ms")
        add("tick starts late by, 99 %", jitter["p99"], "ms")
        add("tick starts late by, at most", jitter["max"], "ms")
    return table
