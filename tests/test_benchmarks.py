"""The benchmark command works and says what it promises; what it measures is nobody's test."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FIGURE = {
    "name", "unit", "better", "median", "min", "max", "samples", "floor", "ratio", "ratio_min", "ratio_max",
    "target", "stretch", "ratio_target", "ratio_stretch", "note",
}  # fmt: skip


def benchmarks(*flags: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "benchmarks", *flags]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    """The record and the page of the fastest race with the smallest counts."""
    folder = tmp_path_factory.mktemp("benchmarks")
    record, page = folder / "latest.json", folder / "performance.md"
    done = benchmarks("--quick", "--only", "wire", "--json", str(record), "--page", str(page))
    assert done.returncode == 0, done.stderr
    assert not done.stdout
    return json.loads(record.read_text(encoding="utf-8")), page.read_text(encoding="utf-8")


def test_the_record_says_what_was_measured_on_what(written: tuple[dict[str, Any], str]) -> None:
    record, _ = written
    assert set(record) == {"schema", "date", "seconds", "machine", "versions", "races"}
    assert record["machine"]["cores"] >= 1
    assert record["versions"]["numpy"] != "absent"
    assert set(record["races"]) == {"wire"}


def test_every_figure_is_whole_and_names_a_floor_that_is_there(written: tuple[dict[str, Any], str]) -> None:
    race = written[0]["races"]["wire"]
    assert race["error"] is None
    assert race["effort"] == "quick"
    names = {figure["name"] for figure in race["figures"]}
    for figure in race["figures"]:
        assert set(figure) == FIGURE
        assert figure["min"] <= figure["median"] <= figure["max"]
        assert figure["floor"] is None or figure["floor"] in names
        assert (figure["ratio"] is None) == (figure["floor"] is None)


def test_an_upload_costs_little_more_than_its_payload(written: tuple[dict[str, Any], str]) -> None:
    uploads = [figure for figure in written[0]["races"]["wire"]["figures"] if figure["ratio_target"]]
    assert len(uploads) == 3
    assert all(figure["ratio"] <= figure["ratio_target"] for figure in uploads)


def test_the_page_has_a_row_for_every_figure(written: tuple[dict[str, Any], str]) -> None:
    record, page = written
    assert page.startswith("# Performance\n")
    assert all(f"| {figure['name']} |" in page for figure in record["races"]["wire"]["figures"])


def test_an_unknown_race_is_refused() -> None:
    done = benchmarks("--only", "nonsense")
    assert done.returncode == 2
    assert "nonsense" in done.stderr
