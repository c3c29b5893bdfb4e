"""The report: claims with verdicts, figures, and the conditions of the runs, as Markdown and as one HTML file."""

import base64
import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from meanflock.results import statistics
from meanflock.studies.markdown import table
from research.reproduction.figures import FIGURES, titled
from research.reproduction.outcome import number, show
from research.reproduction.tables import Results, View
from research.reproduction.verdict import VERDICTS, Share, shares

# -- words -------------------------------------------------------------------------------------------------------------


RULE = (
    "A check holds if its whole 95 % interval over seeds lies on the claimed side of the threshold. It fails if the "
    "whole interval lies on the other side, and is undecided if the interval contains the threshold. A claim is "
    "reproduced if all its checks hold, not reproduced if one fails, and undecided if none fails and one is "
    "undecided or has no data. It is not testable if no data can decide it, if all its data are missing, or if they "
    "come from a single seed (unless the run has no randomness). A claim that holds is not called reproduced if its "
    "checks can hardly fail: it is “reproduced, by construction” if it follows from the question, and “not refuted” if "
    "it can fail only when a learner or a state diverges. "
    "Methods are paired by seed: the same seed is the same wind. Means, differences and slopes have Student's "
    "interval, ratios of means Fieller's, shares of runs Clopper and Pearson's, and counts Garwood's. A best case "
    "(“up to”) is the comparison with the largest lower bound over all grid points and baselines. Its interval "
    "is wide enough to hold for all comparisons at once, and it fails only if all of them fail. “Most” of a grid is "
    "more than half of its points. claims.toml has the thresholds and their reading."
)


def values(record: Mapping[str, Any]) -> list[str]:
    """The numbers of a claim, one line each: `mfgfl-hf: 21.3 [20.1, 22.5]`."""
    value, interval = record["value"], record["ci95"]
    if value is None:
        return []
    if not isinstance(value, Mapping):
        return [interval_text(value, interval)]
    return [f"{name}: {interval_text(each, interval[name])}" for name, each in value.items()]


def interval_text(value: float | None, interval: Sequence[float | None]) -> str:
    """`21.3 [20.1, 22.5]`, with ? for what is unbounded or unknown."""
    low, high = interval
    return number(value) + (f" [{number(low)}, {number(high)}]" if low is not None or high is not None else "")


# -- sections ----------------------------------------------------------------------------------------------------------


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
    "fpk_followed": "Prop. 3: directions of 138 that a flight excites, in which the next three are measured",
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
    "Every claim that runs of S0 alone can decide, judged by the same rule in every setting of the free parameters: "
    "one parameter changed at a time, then all of them drawn at random. No setting was chosen for a claim."
)


def sections_of(view: View, held: Sequence[Share]) -> list[Section]:
    """Heading, text and table of every section except claims and figures."""
    parts = [
        (
            "How it was run",
            f"Version {versions(view)}. Every flight lasts 300 s, even if all UAVs arrive earlier. Trajectories of one "
            "version, scenario and seed are bit-identical on one kind of machine and NumPy build. No number depends on "
            "wall-clock time.",
            how_run(view),
        ),
        (
            "Runs that diverged",
            "They stay in every table and mean. An infinite value makes its interval unbounded.",
            diverged(view),
        ),
    ]
    measured = theory(view)
    if measured[1]:
        words = (
            "`research/reproduction/measure.py` measures the code that flies. Tests compare it with exact solutions."
        )
        parts.append(("Theory checked", words, measured))
    if held:
        parts.append(("Effect of the open parameters", _OPEN, open_parameters(held)))
    words = "Every reading can be changed. The table above shows the effect of the free parameters."
    parts.append(("Errors and gaps of the paper, and our reading", words, readings()))
    return parts


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
    """Errors and gaps of the paper, and our reading."""
    text = Path(__file__).with_name("readings.toml").read_text(encoding="utf-8")
    items = tomllib.loads(text)["reading"]
    rows = [[item["topic"], item["printed"], item["reading"], item["where"]] for item in items]
    return ("what", "in the paper", "our reading", "where to change it"), rows


def open_parameters(held: Sequence[Share]) -> Table:
    """The share of settings in which each claim holds, and these settings if they are few."""
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
    """Measurements of the theory: mean over seeds with interval."""
    rows = []
    for name, words in THEORY.items():
        if name in view.measured:
            estimate = statistics.mean(view.measured[name])
            text = show(estimate) if estimate.bounded else f"{estimate.value:.3g}"
            rows.append([words, text, f"{estimate.n}"])
    return ("what", "mean and 95 % interval", "seeds"), rows


def versions(view: View) -> str:
    """The code the runs were flown with."""
    return ", ".join(view.runs.distinct("version")) if "version" in view.runs else "unknown"


# -- Markdown ----------------------------------------------------------------------------------------------------------


_MOST = 8  # numbers of a claim


def _few(lines: list[str]) -> list[str]:
    """The first lines, and the number of further lines in claims.json."""
    return lines if len(lines) <= _MOST else [*lines[:_MOST], f"… {len(lines) - _MOST} more in claims.json"]


def markdown(
    sections: Sequence[Section],
    records: Sequence[Mapping[str, Any]],
    tally: Mapping[str, int],
    drawn: Mapping[str, Path],
    out: Path,
) -> str:
    """The text of the file.

    Args:
        records: of `verdict.evaluate`. tally: how many of them have each verdict. drawn: a picture for a figure's name.
        out: the folder the file is for; pictures in it are linked from there.
    """
    seen = ", ".join(f"{count} {name}" for name, count in tally.items())
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
    lines += table(("id", "figure", "claim", "measured", "verdict", "why"), rows)
    lines += ["", "## Figures", ""]
    for name, path in drawn.items():
        where = path.relative_to(out).as_posix()
        lines += [f"![{name}]({where})", "", f"**{titled(name)}.** {FIGURES[name][1]}", ""]
    for heading, words, shown in sections:
        lines += [f"## {heading}", "", words, "", *table(*shown), ""]
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


def _claim(record: Mapping[str, Any]) -> str:
    tests = "".join(
        f"<li class='{test['outcome']}'>{escape(test['what'])} = "
        f"{escape(interval_text(test['value'], test['ci95']))}, needs {escape(test['needs'])} "
        f"({test['seeds']} seeds)</li>"
        for test in record["tests"]
    )
    numbers = "".join(f"<li>{escape(line)}</li>" for line in values(record))
    text = f"numbers and {len(record['tests'])} comparisons"
    more = f"<details><summary>{text}</summary><ul>{numbers}</ul><ul>{tests}</ul></details>"
    return (
        f"<article class='{_class(record['verdict'])}' id='{record['id']}'>"
        f"<header><b>{record['id']}</b> <span class='fig'>"
        f"{escape(record['figure'])}</span> <span class='verdict'>{escape(record['verdict'])}</span></header>"
        f"<p>{escape(record['statement'])}</p>"
        f"<p class='how'>{escape(record['metric'])} — {escape(record['scenario'])}</p>"
        f"<p class='why'>{escape(record['reason'])}</p>{more if record['tests'] else ''}</article>"
    )


def _class(verdict: str) -> str:
    """The class that `report.css` colours a verdict by."""
    return verdict.replace(",", "").replace(" ", "-")


def _figure(name: str, path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    caption = escape(FIGURES[name][1])
    return (
        f"<figure id='{name}'><img alt='{caption}' src='data:image/png;base64,{data}'>"
        f"<figcaption><b>{titled(name)}.</b> {caption}</figcaption></figure>"
    )


def html(
    sections: Sequence[Section],
    records: Sequence[Mapping[str, Any]],
    tally: Mapping[str, int],
    drawn: Mapping[str, Path],
) -> str:
    """The text of the file.

    Args:
        records: of `verdict.evaluate`. tally: how many of them have each verdict. drawn: a picture for a figure's name.
    """
    css = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    seen = "".join(f"<span class='{_class(name)}'><b>{count}</b> {name}</span>" for name, count in tally.items())
    tables = "".join(
        f"<section><h2>{escape(heading)}</h2><p>{escape(words)}</p>{_html_table(table)}</section>"
        for heading, words, table in sections
    )
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>The paper's claims, checked</title><style>{css}</style></head><body><main>"
        f"<h1>The paper's claims, checked</h1><p class='tally'>{seen}</p>"
        f"<section><h2>The rule</h2><p>{escape(RULE)}</p></section>"
        f"<section><h2>Claims</h2><div class='claims'>{''.join(map(_claim, records))}</div></section>"
        f"<section><h2>Figures</h2>{''.join(_figure(name, path) for name, path in drawn.items())}</section>"
        f"{tables}</main></body></html>\n"
    )


# -- files -------------------------------------------------------------------------------------------------------------


def write_report(
    results: Results,
    records: Sequence[Mapping[str, Any]],
    out: Path,
    measured: Mapping[str, Sequence[float]] | None = None,
) -> list[Path]:
    """Writes report.md, report.html and claims.json into `out`.

    Args:
        records: of `verdict.evaluate`. measured: of `measure.measure`. Figures that `draw` did not write into
            `out`/figures are left out.
    """
    folder = out / "figures"
    drawn = {name: folder / f"{name}.png" for name in FIGURES if (folder / f"{name}.png").is_file()}
    out.mkdir(parents=True, exist_ok=True)
    view = View.from_results(results, measured)
    paths = [out / "report.md", out / "report.html", out / "claims.json"]
    sections, tally = sections_of(view, shares(results)), counts(records)
    paths[0].write_text(markdown(sections, records, tally, drawn, out), encoding="utf-8")
    paths[1].write_text(html(sections, records, tally, drawn), encoding="utf-8")
    paths[2].write_text(json.dumps(list(records), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return paths


def counts(records: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """Number of the paper's claims with each verdict."""
    seen = Counter(record["verdict"] for record in records if record["id"].startswith("C"))
    return {name: seen[name] for name in VERDICTS}
