"""The report as Markdown."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from meanflock.studies.markdown import table
from meanflock.studies.paper.figures import draw as figures
from meanflock.studies.paper.figures.draw import FIGURES
from meanflock.studies.paper.report.claims import RULE, values
from meanflock.studies.paper.report.sections import Section

_MOST = 8  # numbers of a claim


def _few(lines: list[str]) -> list[str]:
    """The first lines, and how many more claims.json has."""
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
        lines += [f"![{name}]({where})", "", f"**{figures.titled(name)}.** {FIGURES[name][1]}", ""]
    for heading, words, shown in sections:
        lines += [f"## {heading}", "", words, "", *table(*shown), ""]
    return "\n".join(lines)
