"""The cost model of `docs/scaling.md`: a fit to what `scale` and `scale_processes` measured, a figure, and its tables.

`python -m benchmarks --only scale scale_processes --json benchmarks/scaling.json && python -m benchmarks.scaling`
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from benchmarks import sizes, store
from benchmarks.machine import BUSY_LOAD, ROOT
from meanflock.channel.link import slots_needed
from meanflock.kernels.mean_field.layout import MODEL_FLOATS
from meanflock.studies.markdown import replaced
from meanflock.swarm import scenario, state
from meanflock.swarm.wire import control
from meanflock.worldsim.alignment import EXACT

Floats = NDArray[np.float64]

RECORD = ROOT / "benchmarks" / "scaling.json"
PAGE = ROOT / "docs" / "scaling.md"
PICTURE = ROOT / "docs" / "pictures" / "scaling.png"
RACES = ("scale", "scale_processes")
TERMS = {  # what of a sample a coefficient multiplies; ms
    "a, a tick": lambda uavs, processes, links: 1.0,
    "c, a UAV": lambda uavs, processes, links: uavs,
    "d, a pair of up to 3,000 UAVs (N²)": lambda uavs, processes, links: min(uavs, EXACT) ** 2,
    "e, a radio link": lambda uavs, processes, links: links,
    "n, the network": lambda uavs, processes, links: float(processes > 0),
    "b, a process": lambda uavs, processes, links: processes,
}


@dataclass(frozen=True)
class Fit:
    """t = a + c N + d N² + e L, and n + b P where P processes hold the UAVs; every coefficient ms, none negative.

    N² is at most `EXACT`²: of more UAVs the alignment is of a sample of pairs.

    samples: (K, 4), [N, P, L, t in ms]. relative: (K,), model / measured − 1.
    """

    coefficients: Floats
    samples: Floats
    relative: Floats

    def ms(self, uavs: float, processes: float = 0, links: float = 0) -> float:
        """The tick the model expects."""
        return float(_row(uavs, processes, links) @ self.coefficients)


def _row(uavs: float, processes: float, links: float) -> Floats:
    return np.array([term(uavs, processes, links) for term in TERMS.values()])


def fit(samples: Floats) -> Fit:
    """Least squares of relative errors, so that a tick of 0.4 ms counts as much as one of 60."""
    rows = np.array([_row(*sample[:3]) for sample in samples])
    coefficients, _ = nnls(rows / samples[:, 3:], np.ones(len(samples)))
    return Fit(coefficients, samples, rows @ coefficients / samples[:, 3] - 1.0)


def samples_of(record: dict[str, Any]) -> Floats:
    """[N, P, L, ms] of every sample of both races, `(K, 4)`."""
    found = [
        [sample["uavs"], sample["processes"], sample["links"], sample["ms"]]
        for race in RACES
        for sample in record["races"].get(race, {}).get("details", {}).get("samples", ())
    ]
    return np.array(found, dtype=np.float64).reshape(-1, 4)


# -- what follows from the code alone -----------------------------------------------------------------------------


def sizes_table(record: dict[str, Any]) -> list[str]:
    """Bytes of one UAV."""
    f4, f8 = 4, 8
    row = f8 * 2 * state.PLANE + f4 * state.PLANE + f4 * len(sizes.declared("mfgfl-hf").diagnostics) + 1 + f4
    pss = [figure for figure in record["races"]["scale_processes"]["figures"] if figure["name"].startswith("PSS of")]
    each = [figure["median"] / int(figure["name"].split()[2]) for figure in pss]
    upload = sizes.size(sizes.act((sizes.upload("mfgfl-hf"),))) - sizes.size(sizes.act())
    return [
        "| one UAV | bytes |",
        "|---|---:|",
        f"| asked and answered, a tick, a process each | {sizes.size(sizes.sense())} + {sizes.size(sizes.act())} |",
        f"| telemetry, a tick | {row} |",
        f"| its model, mfgfl-hf: payload, on the bus | {MODEL_FLOATS * f4}, {upload} |",
        f"| what it has learned, in memory | {MODEL_FLOATS * f8} |",
        f"| its process, shared pages counted once (PSS) | {min(each):.0f}–{max(each):.0f} MiB |",
    ]


def future_table(fitted: Fit) -> list[str]:
    """Cost of 10⁴ and 10⁶ UAVs with today's design."""
    flown = scenario.load(None)
    radio, hf_floats = flown.radio, sizes.declared("mfgfl-hf").parameters
    bits = hf_floats * radio.bits_per_float
    slots = slots_needed(radio, bits)
    spectrum = 100e6

    def uploads(uavs: float) -> float:
        return flown.federation.fraction * uavs

    def airtime_s(uavs: float, slots_each: int, senders: float) -> float:
        return senders * slots_each * radio.coherence_time_s * radio.bandwidth_hz / spectrum

    lines = {
        "processes of one UAV: memory": lambda n: _bytes(13 * 2**20 * n),
        "… and a tick": lambda n: _seconds(fitted.ms(n, n) / 1e3),
        "processes of 250 UAVs: memory": lambda n: _bytes(13 * 2**20 * n / 250 + 25e3 * n),
        "… and a tick without metrics (b P + c N)": lambda n: _seconds(
            (fitted.ms(n, n / 250) - fitted.ms(n) + fitted.coefficients[1] * n) / 1e3
        ),
        "uploads of a round, mfgfl-hf": lambda n: f"{uploads(n) * bits / 1e6:,.0f} Mbit",
        "… in one message to one leader": lambda n: f"{_bytes(uploads(n) * bits / 8)} of {control.MAX_BYTES >> 20} MiB",
        "… spectrum, a band each as in the paper": lambda n: f"{uploads(n) * radio.bandwidth_hz / 1e9:,.0f} GHz",
        "… or time in 100 MHz, of a round's 20 s": lambda n: _seconds(airtime_s(n, slots, uploads(n))),
        "hjb: states of a tick in 100 MHz, of its 100 ms": lambda n: _seconds(airtime_s(n, 1, n)),
        "hjb: links, everyone within range": lambda n: f"{n * (n - 1):.0e}",
        "a block of 20 ticks of telemetry": lambda n: f"{_bytes(20 * 57 * n)} of 64 MiB",
    }
    return ["| | N = 10⁴ | N = 10⁶ |", "|---|---:|---:|"] + [
        f"| {name} | {value(1e4)} | {value(1e6)} |" for name, value in lines.items()
    ]


def _bytes(value: float) -> str:
    for unit in ("B", "KiB", "MiB", "GiB"):
        if value < 1024:
            return f"{value:.3g} {unit}"
        value /= 1024
    return f"{value:,.3g} TiB"


def _seconds(value: float) -> str:
    return f"{value * 1e3:.3g} ms" if value < 1 else f"{value:.3g} s" if value < 120 else f"{value / 60:,.3g} min"


def fit_table(fitted: Fit) -> list[str]:
    """Coefficients and residuals."""
    lines = ["| coefficient | µs |", "|---|---:|"]
    lines += [f"| {name} | {1e3 * value:.3g} |" for name, value in zip(TERMS, fitted.coefficients, strict=True)]
    lines += ["", "| N | processes | links | measured, ms | model, ms | residual |", "|---:|---:|---:|---:|---:|---:|"]
    for (uavs, processes, links, ms), off in zip(fitted.samples, fitted.relative, strict=True):
        where = f"{processes:.0f}" if processes else "in one"
        lines.append(f"| {uavs:.0f} | {where} | {links:.0f} | {ms:.3g} | {ms * (1 + off):.3g} | {off * 100:+.0f} % |")
    return lines


# -- page and figure ----------------------------------------------------------------------------------------------


def draw(fitted: Fit, path: Path) -> None:
    """A tick over N: measured points, the model's lines, real time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 3.9), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    uavs, processes, links, ms = fitted.samples.T
    many = np.geomspace(10, 1e4, 60)
    kinds = (
        ("a process each", "#0072B2", "o", (processes > 0) & (processes == uavs), lambda n: fitted.ms(n, n)),
        ("hjb, all speak, in one process", "#D55E00", "s", links > 0, lambda n: fitted.ms(n, 0, n * (n - 1))),
        ("processes of 250", "#009E73", "^", (processes > 0) & (processes < uavs), lambda n: fitted.ms(n, n / 250)),
        ("mfgfl-hf, in one process", "#222222", "D", (processes == 0) & (links == 0), fitted.ms),
    )
    for name, colour, marker, mine, line in kinds:
        axes.plot(many, [line(n) for n in many], color=colour, lw=1.2, label=name)
        axes.plot(uavs[mine], ms[mine], marker, color=colour, ms=5)
    axes.axhline(100.0, color="#9A9A9A", ls=(0, (4, 2)), lw=1)
    axes.annotate("real time: 100 ms", (10, 100), (4, -11), textcoords="offset points", color="#6A6A6A", fontsize=8)
    axes.set(xscale="log", yscale="log", xlabel="number of UAVs", ylabel="tick (ms)", xlim=(10, 1e4), ylim=(0.1, 5e3))
    axes.legend(frameon=False, fontsize=8, loc="upper left", title="lines: the fitted model")
    axes.get_legend().get_title().set_fontsize(8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150, metadata={"Software": None})


def main(arguments: list[str] | None = None) -> int:
    """Reads the record, writes page and picture."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, default=RECORD, help="a record with both races")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--picture", type=Path, default=PICTURE)
    given = parser.parse_args(arguments)
    record = store.read(given.json)
    missing = [race for race in RACES if not record or not record["races"].get(race, {}).get("details", {})]
    if record is None or missing:
        print(f"{given.json}: no {' and '.join(missing)}; {__doc__.splitlines()[2].strip('`')}", file=sys.stderr)
        return 2
    fitted = fit(samples_of(record))
    machine = record["machine"]
    busy = f"; **it was busy, load {machine['load_before']}**" if machine["load_before"] > BUSY_LOAD else ""
    tables = {
        "measured on": [f"Measured {record['date']} on {machine['cpu']}, {machine['cores']} cores{busy}."],
        "fit": fit_table(fitted),
        "bytes": sizes_table(record),
        "future": future_table(fitted),
    }
    page = given.page.read_text(encoding="utf-8")
    for name, lines in tables.items():
        page = replaced(page, f"<!-- {name} -->", "<!-- end -->", lines)
    given.page.write_text(page, encoding="utf-8")
    draw(fitted, given.picture)
    print(f"{given.page}\n{given.picture}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
