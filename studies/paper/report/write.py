"""The report: every claim with its verdict, the figures, and how they came about; as Markdown and as one HTML file."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from meanflock.studies.paper import verdict
from meanflock.studies.paper.figures.draw import FIGURES
from meanflock.studies.paper.report.html import html
from meanflock.studies.paper.report.markdown import markdown
from meanflock.studies.paper.report.sections import sections_of
from meanflock.studies.paper.sensitivity import shares
from meanflock.studies.paper.tables import Results
from meanflock.studies.paper.view import View


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
    view = View.of(results, measured)
    paths = [out / "report.md", out / "report.html", out / "claims.json"]
    sections, tally = sections_of(view, shares(results)), counts(records)
    paths[0].write_text(markdown(sections, records, tally, drawn, out), encoding="utf-8")
    paths[1].write_text(html(sections, records, tally, drawn), encoding="utf-8")
    paths[2].write_text(json.dumps(list(records), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return paths


def counts(records: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """How many claims of the paper have each verdict."""
    seen = Counter(record["verdict"] for record in records if record["id"].startswith("C"))
    return {name: seen[name] for name in verdict.VERDICTS}
