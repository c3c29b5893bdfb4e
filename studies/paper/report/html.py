"""The report as one HTML file, with style and figures in it."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from meanflock.studies.paper.figures import draw as figures
from meanflock.studies.paper.figures.draw import FIGURES
from meanflock.studies.paper.report.claims import RULE, interval_text, values
from meanflock.studies.paper.report.sections import Section, Table


def _table(table: Table) -> str:
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
    said = f"numbers and {len(record['tests'])} comparisons"
    more = f"<details><summary>{said}</summary><ul>{numbers}</ul><ul>{tests}</ul></details>"
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
    said = escape(FIGURES[name][1])
    return (
        f"<figure id='{name}'><img alt='{said}' src='data:image/png;base64,{data}'>"
        f"<figcaption><b>{figures.titled(name)}.</b> {said}</figcaption></figure>"
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
        f"<section><h2>{escape(heading)}</h2><p>{escape(words)}</p>{_table(table)}</section>"
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
