"""The benchmark command, its record and its pages; no test judges a measured time."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks import page, profile, scaling, store
from benchmarks.__main__ import PAGE
from benchmarks.peer import environment
from benchmarks.processes import BenchmarkFailed
from tests.commands import printed

ROOT = Path(__file__).parents[1]
FIGURE = {
    "name", "unit", "better", "median", "min", "max", "samples", "floor", "ratio", "ratio_min", "ratio_max",
    "target", "stretch", "ratio_target", "ratio_stretch", "note",
}  # fmt: skip


def test_a_race_leaves_a_record_and_a_page_of_all_its_figures(tmp_path: Path, capsys: Any) -> None:
    record, page = tmp_path / "latest.json", tmp_path / "performance.md"
    flags = ("--quick", "--only", "wire", "--json", record, "--page", page)
    assert printed(sys.executable, "-m", "benchmarks", *flags, cwd=ROOT) == ""
    written = json.loads(record.read_text(encoding="utf-8"))
    assert set(written) == {"schema", "date", "seconds", "machine", "versions", "races"}
    race, text = written["races"]["wire"], page.read_text(encoding="utf-8")
    assert (race["error"], race["effort"]) == (None, "quick")
    names = {figure["name"] for figure in race["figures"]}
    for figure in race["figures"]:
        assert set(figure) == FIGURE
        assert figure["min"] <= figure["median"] <= figure["max"]
        assert figure["floor"] is None or figure["floor"] in names
        assert (figure["ratio"] is None) == (figure["floor"] is None)
        assert f"| {figure['name']} |" in text
    uploads = [figure for figure in race["figures"] if figure["ratio_target"]]
    assert len(uploads) == 3
    assert all(figure["ratio"] <= figure["ratio_target"] for figure in uploads)  # bytes, which no load changes
    assert scaling.main(["--json", str(record)]) == 2
    assert "--only scale scale_processes" in capsys.readouterr().err


def found(*ratios: tuple[str, float, str], effort: str = "full", error: str | None = None) -> dict[str, Any]:
    figures = [{"name": name, "ratio": ratio, "better": better} for name, ratio, better in ratios]
    return {"races": {"race": {"effort": effort, "error": error, "figures": figures}}}


def test_a_ratio_that_grew_by_more_than_noise_is_named_and_one_that_fell_is_not() -> None:
    before = found(("tick", 2.0, "lower"), ("speed", 2.0, "higher"), ("size", 2.0, "neither"))
    assert store.worse(found(("tick", 2.2, "lower"), ("speed", 1.8, "higher"), ("size", 9.0, "neither")), before) == []
    worse = store.worse(found(("tick", 3.0, "lower"), ("speed", 1.0, "higher"), ("size", 2.0, "neither")), before)
    assert [sentence.split(" (")[-1] for sentence in worse] == ["50 % worse)", "100 % worse)"]
    assert "3.00 times its floor, was 2.00" in worse[0]
    assert store.worse(found(error="it fell over"), before) == ["race: cannot be measured any more: it fell over"]
    few = found(("tick", 2.0, "lower"), ("speed", 2.0, "higher"))
    assert store.worse(few, before) == ["race: size: not measured any more"]


PEER = """
import sys
sys.path.insert(0, {scripts!r})
from serve import serve
serve(lambda: sum(range(1000)))
"""


def test_a_peer_is_timed_in_a_process_and_a_folder_that_end_with_it() -> None:
    with environment.Peer([sys.executable, "-c", PEER.format(scripts=str(environment.SCRIPTS))], "peer 1") as peer:
        assert 0.0 < peer.measure(10) < 1000.0
    assert peer._process.poll() is not None
    assert not Path(peer._folder.name).exists()
    with pytest.raises(BenchmarkFailed, match="ready"):  # it says another word
        environment.Peer([sys.executable, "-c", "print('hello')"], "peer 1")


def test_the_page_on_scaling_is_that_of_the_record_beside_it(tmp_path: Path) -> None:
    page, picture = Path(shutil.copy(scaling.PAGE, tmp_path)), tmp_path / "scaling.png"
    assert scaling.main(["--page", str(page), "--picture", str(picture)]) == 0
    assert page.read_text(encoding="utf-8") == scaling.PAGE.read_text(encoding="utf-8")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_measurements_on_the_page_are_those_of_the_record() -> None:
    text = PAGE.read_text(encoding="utf-8")
    record = store.read(store.LATEST)
    assert page.page(record, text) == text


def test_what_a_tick_is_taken_apart_into_is_there() -> None:
    with profile.Stopwatch() as watch:
        watch.wrap([*profile.LEARNER, *profile.CODEC, *profile.WORLD, *profile.ZENOH_BUS])
        assert watch.absent == []
