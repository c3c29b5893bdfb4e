"""The table of a study in LaTeX, for the package booktabs: means with half of their 95 % intervals, and verdicts."""

import math
import re
from collections.abc import Iterable
from typing import Any

from meanflock.results import quantities, statistics
from meanflock.results.statistics import Estimate
from meanflock.studies.means import METRICS, Means
from meanflock.studies.tradeoff import Tradeoff

_ESCAPES = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "φ": r"$\phi$",
    "∫": r"$\int$",
    "√": r"$\surd$",
    "²": r"$^2$",
    "³": r"$^3$",
    "σ": r"$\sigma$",
    "μ": r"$\mu$",
    "·": r"$\cdot$",
    "−": r"$-$",
    "…": r"\dots{}",
    "\n": " ",
}
_SPECIAL = re.compile("|".join(map(re.escape, _ESCAPES)))
_INDEX = re.compile(r"φ_(\w)")
_SCALES = ((1e9, "G"), (1e6, "M"), (1e3, "k"))
_ROUNDING = 1e-12  # half of an interval by its mean, at most, of flights with equal figures
_HEAD = """\
% \\usepackage{booktabs}
% Means over n flights, and half widths of their 95 % intervals. Bold: significantly best, by t tests paired by seed,
% with Holm's correction, 5 %. Where none is bold, the best is undecided."""


def escaped(text: str) -> str:
    """Text for LaTeX, with its special characters escaped and symbols as mathematics."""
    parts = _INDEX.split(text)  # text and index, in turns
    return "".join(
        rf"$\phi_{part}$" if at % 2 else _SPECIAL.sub(lambda found: _ESCAPES[found.group()], part)
        for at, part in enumerate(parts)
    )


def latex_table(means: Means, tradeoff: Tradeoff | None = None) -> str:
    """A `tabular` of all points and metrics; with a tradeoff, whether each point is on the Pareto front."""
    numbers = {metric: _numbers(means, metric) for metric in METRICS}
    shown = [metric for metric in METRICS if any(one.n for one in numbers[metric].values())]
    scales = {metric: _scale(metric, numbers[metric].values()) for metric in shown}
    names = [means.names[place] for place in means.varying]
    heads = [*map(escaped, names), "$n$", *(_head(metric, scales[metric][1]) for metric in shown)]
    rows = []
    for values, summaries in means.points.items():
        cells = [*(escaped(str(values[place])) for place in means.varying), str(len(summaries))]
        for metric in shown:
            text = value_text(numbers[metric][values], scales[metric][0])
            cells.append(rf"$\mathbf{{{text}}}$" if means.verdicts.get((values, metric)) == "best" else f"${text}$")
        rows.append([*cells, tradeoff.placed[values].place] if tradeoff else cells)
    heads += ["Pareto"] if tradeoff else []
    columns = "l" * len(names) + "r" * (len(shown) + 1) + ("l" if tradeoff else "")
    lines = [" & ".join(row) + r" \\" for row in (heads, *rows)]
    body = [r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule"]
    return "\n".join([_HEAD, rf"\begin{{tabular}}{{{columns}}}", *body, r"\end{tabular}", ""])


def value_text(found: Estimate, scale: float = 1.0) -> str:
    """A mean and half of its interval, both to two digits of the latter; a mean without interval, or with one of
    rounding errors, to four."""
    if found.n == 0:
        return "-"
    value, half = found.value / scale, (found.high - found.value) / scale
    if not found.bounded or half <= _ROUNDING * abs(value):
        return _plain(f"{value:.4g}")
    digits = max(0, 1 - math.floor(math.log10(half)))
    return rf"{value:.{digits}f} \pm {half:.{digits}f}"


def _numbers(means: Means, metric: str) -> dict[tuple[Any, ...], Estimate]:
    return {
        values: statistics.mean([quantities.number(each, metric) for each in summaries])
        for values, summaries in means.points.items()
    }


def _plain(text: str) -> str:
    """A number without an exponent of Python: `1.2e-05` as 1.2 times a power of ten."""
    digits, _, exponent = text.partition("e")
    return rf"{digits} \times 10^{{{int(exponent)}}}" if exponent else digits


def _scale(metric: str, found: Iterable[Estimate]) -> tuple[float, str]:
    """Size and letter of the prefix of bits; 1 and none for other units."""
    most = max((one.value for one in found if one.n), default=0.0)
    if quantities.quantity(metric) is not quantities.PAYLOAD:
        return 1.0, ""
    return next(((scale, letter) for scale, letter in _SCALES if most >= scale), (1.0, ""))


def _head(metric: str, prefix: str) -> str:
    named = quantities.quantity(metric)
    unit = f"{prefix}bit" if named is quantities.PAYLOAD else named.unit
    name = named.heading.replace("-\n", "").replace("\n", " ") or named.name
    return escaped(f"{name} ({unit})" if unit else name)
