"""The report: every claim with its verdict, the figures, and how they came about; as Markdown and as one HTML file."""

import base64
import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from meanflock.groundstation.paper import statistics, verdict
from meanflock.groundstation.paper.figures import FIGURES
from meanflock.groundstation.paper.outcome import show
from meanflock.groundstation.paper.sensitivity import Share, shares
from meanflock.groundstation.paper.tables import Results
from meanflock.groundstation.paper.view import View

VERDICTS = (verdict.REPRODUCED, verdict.NOT_REPRODUCED, verdict.UNDECIDED, verdict.NOT_TESTABLE)
RULE = (
    "A check holds if its whole 95 % interval over seeds lies on the claimed side of the threshold, fails if the "
    "whole interval lies on the other side, and is undecided if the threshold lies in the interval. A claim is "
    "reproduced if every check of it holds, not reproduced if one fails, and undecided if none fails and one is "
    "undecided. It is not testable if no data could decide, or if they are missing or come from a single seed "
    "(unless the run has no chance in it). "
    "Methods are paired by seed: the same seed is the same wind. Means, differences and slopes have Student's "
    "interval, ratios of means Fieller's, shares of runs Clopper and Pearson's, counts Garwood's. A best case "
    "(“up to”) is the comparison with the largest lower bound over all grid points and baselines, its interval "
    "widened to hold for all of them at once; it fails only if all of them do. “Most” of a grid is more than half of "
    "its points. Thresholds and their reading are data: claims.toml."
)
THEORY = {
    "hjb_state_growth": "Prop. 1: ‖s‖, last third over first two thirds of a long flight",
    "hjb_value_growth": "Prop. 1: ‖ŵ_H‖, likewise",
    "hjb_lost": "Prop. 1: UAVs that left every bound",
    "mfg_state_growth": "Cor. 1: ‖s‖ under Algorithm 2, likewise",
    "mfg_value_growth": "Cor. 1: ‖ŵ_H‖",
    "mfg_density_growth": "Prop. 2, Cor. 1: ‖ŵ_F‖",
    "mfg_lost": "Cor. 1: UAVs that left every bound",
    "fpk_step_over_bound": "Prop. 3: μ_F over 2/λ_max(R)",
    "fpk_learnable": "Prop. 3: directions of 138 that one trip can learn at this μ_F",
    "fpk_bias": "Prop. 3: bias left, relative to the start",
    "fpk_msd_ratio": "Prop. 3: simulated over closed-form mean-square deviation",
    "fpk_msd_fall": "Prop. 3: deviation at μ/2 over that at μ",
    "gap_hjb": "Cost of a flight over the optimum of one UAV: Hjb",
    "gap_mfg": "… Mfg",
    "gap_mfgfl-h": "… MfgFL-H",
    "gap_mfgfl-f": "… MfgFL-F",
    "gap_mfgfl-hf": "… MfgFL-HF",
}
Table = tuple[Sequence[str], list[list[str]]]  # header, rows
Section = tuple[str, str, Table]  # heading, words, table
_OPEN = (
    "Each claim about S0 that its runs alone can decide, judged by the same rule in every setting of the free "
    "parameters: one changed at a time, then all drawn at random. No setting was chosen for a claim."
)


def write_report(
    results: Results,
    records: Sequence[Mapping[str, Any]],
    out: Path,
    measured: Mapping[str, Sequence[float]] | None = None,
    figures: Path | None = None,
) -> list[Path]:
    """Writes report.md, report.html and claims.json into `out`.

    Args:
        records: of `verdict.evaluate`. measured: of `measure.measure`. figures: the folder `draw` wrote into, by
            default `out`/figures; figures that are not there are left out.
    """
    folder = figures or out / "figures"
    drawn = {name: folder / f"{name}.png" for name in FIGURES if (folder / f"{name}.png").is_file()}
    out.mkdir(parents=True, exist_ok=True)
    view = View.of(results, measured)
    paths = [out / "report.md", out / "report.html", out / "claims.json"]
    sections = _sections(view, shares(results))
    paths[0].write_text(_markdown(sections, records, drawn, out), encoding="utf-8")
    paths[1].write_text(_html(sections, records, drawn), encoding="utf-8")
    paths[2].write_text(json.dumps(list(records), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return paths


# -- what is said, whatever the format ---------------------------------------------------------------------------------


def counts(records: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """How many claims have each verdict."""
    seen = Counter(record["verdict"] for record in records)
    return {name: seen[name] for name in VERDICTS}


def how_run(view: View) -> Table:
    """Seeds, runs and methods of every experiment."""
    rows = []
    for experiment in view.runs.distinct("experiment"):
        frame = view.runs.where(experiment=experiment)
        seeds = np.unique(frame["seed"].astype(int))
        methods = ", ".join(frame.distinct("method"))
        rows.append(
            [experiment, methods, f"{len(frame)}", f"{seeds[0]}…{seeds[-1]}" if len(seeds) > 1 else f"{seeds[0]}"]
        )
    return ("experiment", "methods", "runs", "seeds"), rows


def diverged(view: View) -> Table:
    """Runs by method in which a learner or a state left every bound, or in which UAVs never arrived."""
    rows = []
    for method in view.runs.distinct("method"):
        frame = view.runs.where(method=method)
        unique = np.unique(frame["key"].astype(str), return_index=True)[1]
        left, home = frame["diverged"][unique], frame["all_arrived"][unique]
        rows.append([method, f"{len(unique)}", f"{int(np.nansum(left))}", f"{int(np.sum(home == 0))}"])
    return ("method", "different runs", "diverged", "some never arrived"), rows


def readings() -> Table:
    """The paper's slips and gaps, and how they are read."""
    text = files("meanflock.groundstation.paper").joinpath("readings.toml").read_text(encoding="utf-8")
    items = tomllib.loads(text)["reading"]
    rows = [[item["topic"], item["printed"], item["reading"], item["where"]] for item in items]
    return ("what", "in the paper", "our reading", "where to change it"), rows


def open_parameters(held: Sequence[Share]) -> Table:
    """In what share of the settings each claim holds, and in which it does where they are few."""
    header = ("claim", "settings", "holds", "undecided", "fails", "holds in")
    few = 3
    rows = []
    for share in held:
        where = (
            "; ".join(share.kept_by) if 0 < share.holds <= few else "–" if not share.holds else f"{share.holds} of them"
        )
        numbers = (share.settings, share.holds, share.undecided, share.against)
        rows.append([share.id, *map(str, numbers), where])
    return header, rows


def theory(view: View) -> Table:
    """What the theory's checks measured, mean over seeds with interval."""
    rows = []
    for name, words in THEORY.items():
        if name in view.measured:
            estimate = statistics.mean(view.measured[name])
            said = show(estimate) if estimate.bounded else f"{estimate.value:.3g}"
            rows.append([words, said, f"{estimate.n}"])
    return ("what", "mean and 95 % interval", "seeds"), rows


def versions(view: View) -> str:
    """The code the runs were flown with."""
    return ", ".join(view.runs.distinct("version")) if "version" in view.runs else "unknown"


def values(record: Mapping[str, Any]) -> list[str]:
    """The numbers of a claim, one line each: `mfgfl-hf: 21.3 [20.1, 22.5]`."""
    value, interval = record["value"], record["ci95"]
    if value is None:
        return []
    if not isinstance(value, Mapping):
        return [_one(value, interval)]
    return [f"{name}: {_one(each, interval[name])}" for name, each in value.items()]


def _one(value: float | None, interval: Sequence[float | None]) -> str:
    def number(each: float | None) -> str:
        if each is None:
            return "?"
        return f"{each:,.0f}" if abs(each) >= 1000 else f"{each:.3g}"

    low, high = interval
    return number(value) + (f" [{number(low)}, {number(high)}]" if low is not None or high is not None else "")


def _sections(view: View, held: Sequence[Share]) -> list[Section]:
    """Heading, words and table of everything but claims and figures."""
    parts = [
        (
            "How it was run",
            f"Version {versions(view)}. Every flight goes on to 300 s, whatever arrives. Equal version, scenario and "
            "seed fly equal trajectories, to the last bit on one kind of machine and NumPy build; no wall-clock time "
            "enters any number.",
            how_run(view),
        ),
        (
            "Runs that diverged",
            "They stay in every table and mean; what is infinite in them makes an interval unbounded.",
            diverged(view),
        ),
    ]
    measured = theory(view)
    if measured[1]:
        words = "Measured by `measure.py` on the code that flies; the exact identities behind it are in the tests."
        parts.append(("Theory checked", words, measured))
    if held:
        parts.append(("What the open parameters decide", _OPEN, open_parameters(held)))
    words = "Every reading can be changed; how far the results depend on the free ones is the table above."
    parts.append(("Slips and gaps of the paper, and how they are read", words, readings()))
    return parts


# -- Markdown ----------------------------------------------------------------------------------------------------------


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _md_table(table: Table) -> list[str]:
    header, rows = table
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return lines + [f"| {' | '.join(map(_cell, row))} |" for row in rows]


def _few(lines: list[str], most: int = 8) -> list[str]:
    """The first lines, and how many more claims.json has."""
    return lines if len(lines) <= most else [*lines[:most], f"… {len(lines) - most} more in claims.json"]


def _markdown(
    sections: Sequence[Section], records: Sequence[Mapping[str, Any]], drawn: Mapping[str, Path], out: Path
) -> str:
    seen = ", ".join(f"{count} {name}" for name, count in counts(records).items())
    lines = ["# The paper's claims, checked", "", f"{len(records)} claims: {seen}.", "", "## The rule", "", RULE, ""]
    lines += ["## Claims", ""]
    rows = [
        [
            record["id"],
            record["figure"],
            f"{record['statement']} ({record['scenario']})",
            f"{record['metric']}: {'; '.join(_few(values(record)))}",
            f"**{record['verdict']}**",
            record["reason"],
        ]
        for record in records
    ]
    lines += _md_table((("id", "figure", "claim", "measured", "verdict", "why"), rows))
    lines += ["", "## Figures", ""]
    for name, path in drawn.items():
        where = path.relative_to(out) if path.is_relative_to(out) else path
        lines += [f"![{name}]({where.as_posix()})", "", f"**Figure {name[3:]}.** {FIGURES[name][1]}", ""]
    for heading, words, table in sections:
        lines += [f"## {heading}", "", words, "", *_md_table(table), ""]
    return "\n".join(lines)


# -- HTML --------------------------------------------------------------------------------------------------------------


def _html_table(table: Table) -> str:
    header, rows = table
    head = "".join(f"<th>{escape(each)}</th>" for each in header)
    body = "".join(
        "<tr>"
        + "".join(
            f'<td data-label="{escape(name)}">{escape(text)}</td>' for name, text in zip(header, row, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _html_claim(record: Mapping[str, Any]) -> str:
    kind = record["verdict"].replace(" ", "-")
    tests = "".join(
        f"<li class='{test['outcome']}'>{escape(test['what'])} = "
        f"{escape(_one(test['value'], test['ci95']))}, needs {escape(test['needs'])} ({test['seeds']} seeds)</li>"
        for test in record["tests"]
    )
    numbers = "".join(f"<li>{escape(line)}</li>" for line in values(record))
    said = f"numbers and {len(record['tests'])} comparisons"
    more = f"<details><summary>{said}</summary><ul>{numbers}</ul><ul>{tests}</ul></details>"
    return (
        f"<article class='{kind}' id='{record['id']}'><header><b>{record['id']}</b> <span class='fig'>"
        f"{escape(record['figure'])}</span> <span class='verdict'>{escape(record['verdict'])}</span></header>"
        f"<p>{escape(record['statement'])}</p>"
        f"<p class='how'>{escape(record['metric'])} — {escape(record['scenario'])}</p>"
        f"<p class='why'>{escape(record['reason'])}</p>{more if record['tests'] else ''}</article>"
    )


def _html_figure(name: str, path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    said = escape(FIGURES[name][1])
    return (
        f"<figure id='{name}'><img alt='{said}' src='data:image/png;base64,{data}'>"
        f"<figcaption><b>Figure {name[3:]}.</b> {said}</figcaption></figure>"
    )


def _html(sections: Sequence[Section], records: Sequence[Mapping[str, Any]], drawn: Mapping[str, Path]) -> str:
    css = files("meanflock.groundstation.paper").joinpath("report.css").read_text(encoding="utf-8")
    tally = "".join(
        f"<span class='{name.replace(' ', '-')}'><b>{count}</b> {name}</span>"
        for name, count in counts(records).items()
    )
    tables = "".join(
        f"<section><h2>{escape(heading)}</h2><p>{escape(words)}</p>{_html_table(table)}</section>"
        for heading, words, table in sections
    )
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>The paper's claims, checked</title><style>{css}</style></head><body><main>"
        f"<h1>The paper's claims, checked</h1><p class='tally'>{tally}</p>"
        f"<section><h2>The rule</h2><p>{escape(RULE)}</p></section>"
        f"<section><h2>Claims</h2><div class='claims'>{''.join(map(_html_claim, records))}</div></section>"
        f"<section><h2>Figures</h2>{''.join(_html_figure(name, path) for name, path in drawn.items())}</section>"
        f"{tables}</main></body></html>\n"
    )
