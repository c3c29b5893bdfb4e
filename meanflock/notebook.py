"""HTML of runs and studies, which notebooks show in place of a line of text."""

from collections.abc import Callable, Iterable, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meanflock.results.in_words import UNKNOWN, number
from meanflock.results.quantities import Quantity, quantity, table_column
from meanflock.results.quantities import number as figure
from meanflock.swarm.errors import BadInput, printable

if TYPE_CHECKING:
    from meanflock.results.plots.run import RunPicture
    from meanflock.studies.means import Means

_FIGURES = ("t_avg_s", "energy_mean_J", "payload_bits.total", "phi_A", "phi_C_distinct")
_PICTURE = "float:left;width:300px;margin-right:1em"
_RIGHT, _LEFT = "text-align:right", "text-align:left"


def html_of_run(flown: Mapping[str, Any], folder: Path | None, shown: "Callable[[], RunPicture]") -> str:
    """A picture of what is `shown` of a run, if it can be drawn, and the main figures of its summary `flown`."""
    rows = [("arrived", f"{flown['arrived']} of {flown['uavs']} UAVs; {flown['lost']} lost")]
    rows += [("landed for good", f"{flown['landed']} UAVs")] if flown.get("landed") else []
    rows += [("collisions", f"{flown['collisions']} pairs")]
    rows += [(quantity(key).name, _with_unit(figure(flown, key), quantity(key))) for key in _FIGURES]
    if folder is not None:
        rows.append(("folder", str(folder)))
    title = f"{flown['method']}, {flown['uavs']} UAVs, seed {flown['seed']}, {number(flown['sim_time_s'])} s"
    cells = "".join(f"<tr><th style='{_LEFT}'>{_safe(name)}</th>{_cell(value, _LEFT)}</tr>" for name, value in rows)
    return f"<div>{_picture(shown)}<b>{_safe(title)}</b><table>{cells}</table><div style='clear:both'></div></div>"


def html_of_means(means: "Means") -> str:
    """A table of means, with a row for each point and the 95 % interval below each mean."""
    from meanflock.studies.means import METRICS  # only here: it loads SciPy, which a flight does not need

    heads = [*means.names, "n", *(", ".join((each.name, each.unit or "1")) for each in map(quantity, METRICS))]
    rows = []
    for values, row in means.rows():
        cells = [_cell(value, _LEFT) for value in values] + [_cell(row["n"], _RIGHT)]
        for column in map(table_column, METRICS):
            low, high = (row[f"{column}_{end}"] for end in ("low", "high"))
            between = "" if low is None else f"<br><small>{_short(low)} … {_short(high)}</small>"
            cells.append(f"<td style='{_RIGHT}'>{_short(row[column])}{between}</td>")
        rows.append("".join(cells))
    head = "".join(f"<th style='{_LEFT}'>{_safe(name)}</th>" for name in heads)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{_joined(rows)}</tbody></table>"


def _picture(shown: "Callable[[], RunPicture]") -> str:
    try:
        from meanflock.results.plots.thumbnail import thumbnail

        return f"<div style='{_PICTURE}'>{thumbnail(shown())}</div>"
    except (ImportError, BadInput):  # Matplotlib is not installed, or the time series cannot be read
        return ""


def _with_unit(value: float, known: Quantity) -> str:
    return UNKNOWN if value != value else f"{number(value)} {known.unit}".strip()


def _short(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.4g}"


def _joined(rows: Iterable[str]) -> str:
    return "".join(f"<tr>{row}</tr>" for row in rows)


def _cell(value: object, aligned: str) -> str:
    return f"<td style='{aligned}'>{_safe(value)}</td>"


def _safe(text: object) -> str:
    return escape(printable(str(text)))
