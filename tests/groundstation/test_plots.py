"""Plots of anyone's own runs, comparisons and sweeps."""

import shutil
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from meanflock.groundstation.launch.run import Options, fly
from meanflock.groundstation.plots import comparison, plotstyle
from meanflock.groundstation.plots.run import plot_run
from meanflock.groundstation.results import quantities
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load
from tests.groundstation.axes import every_axis


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    flown = load(None, method="mfgfl-h", uavs=4, duration=20.0)
    return fly(flown, Options(out=tmp_path_factory.mktemp("runs"), in_process=True, record=False, quiet=True)).folder


def test_a_run_is_plotted_from_its_folder(run_folder: Path, tmp_path: Path) -> None:
    made = plot_run(run_folder)
    assert {path.name for path in plotstyle.write(made, tmp_path)} == {
        "paths.png",
        "paths.svg",
        "curves.png",
        "curves.svg",
    }
    for each in made.values():
        assert every_axis(each)


def test_a_matplotlibrc_of_the_reader_changes_no_plot(run_folder: Path, tmp_path: Path) -> None:
    ours = [path.read_bytes() for path in plotstyle.write(plot_run(run_folder), tmp_path / "ours")]
    with mpl.rc_context({"axes.facecolor": "red", "savefig.facecolor": "red", "legend.loc": "center"}):
        theirs = [path.read_bytes() for path in plotstyle.write(plot_run(run_folder), tmp_path / "theirs")]
    assert theirs == ours


def test_a_run_whose_events_were_cut_off_is_still_plotted(run_folder: Path) -> None:
    with (run_folder / "events.jsonl").open("a") as events:
        events.write('{"tick": 3, "kind": "coll')
    assert plot_run(run_folder)


def test_no_run_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="name the folder of a run"):
        plot_run(tmp_path)


@pytest.mark.parametrize("damage", ["cut", "flipped", "gone"])
def test_a_time_series_that_cannot_be_read_is_named_with_how_to_mend_it(
    damage: str, run_folder: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(run_folder, tmp_path / "run"))
    path = folder / "timeseries.parquet"
    whole = bytearray(path.read_bytes())
    path.write_bytes(whole[:900])
    if damage == "flipped":
        path.write_bytes(whole[:900] + bytes([whole[900] ^ 255]) + whole[901:])
    elif damage == "gone":
        path.unlink()
    what = "No such file" if damage == "gone" else "damaged: "
    again = rf"fly the run again with `meanflock run {folder / 'scenario.toml'}`"
    with pytest.raises(BadInput, match=rf"^{path}: {what}[^']*; bring the file back, or {again}$"):
        plot_run(folder)


def summaries(level: float, seeds: int = 4) -> list[dict[str, Any]]:
    return [
        {
            "uavs": 4,
            "arrived": 3,
            "t_avg_censored_s": level + seed,
            "energy_mean_J": level,
            "payload_bits": {"total": 1e6 * level},
            "phi_A": level / 10,
            "phi_C_distinct": None if seed == 0 else 0.01,
            "collisions": seed,
        }
        for seed in range(seeds)
    ]


def test_comparison_has_a_row_a_method_and_a_panel_a_metric() -> None:
    made = comparison.plot_compare({"hjb": summaries(20.0), "mfgfl-hf": summaries(18.0)})
    panels = [ax for ax in made.axes if ax.get_visible()]
    assert len(panels) == len(quantities.COMPARED)
    assert [text.get_text() for text in panels[0].get_yticklabels()] == ["hjb", "mfgfl-hf"]


@pytest.mark.parametrize(("level", "seeds"), [(20.0, 4), (0.0, 1), (0.3, 2)])
def test_comparison_covers_no_flight_and_has_no_negative_number(level: float, seeds: int) -> None:
    made = comparison.plot_compare({"hjb": summaries(level, seeds), "mfgfl-hf": summaries(level, seeds)})
    made.draw_without_rendering()
    for ax in made.axes[: len(quantities.COMPARED)]:
        height_px = abs(ax.transData.transform((0.0, 0.0))[1] - ax.transData.transform((0.0, 1.0))[1])
        flights = [line for line in ax.lines if line.get_alpha()]
        others = [line for line in ax.lines if not line.get_alpha()]
        assert [len(line.get_xdata()) for line in flights] == [seeds, seeds]
        for flight in flights:
            apart = min(abs(flight.get_ydata()[0] - other.get_ydata()[0]) for other in others) * height_px
            widest = max(other.get_markersize() for other in others) / 2 * made.dpi / 72
            assert apart > widest
        low, high = ax.get_xlim()
        assert [tick for tick in ax.get_xticks() if low <= tick < 0.0] == []
        assert len([tick for tick in ax.get_xticks() if 0.0 <= tick <= high]) >= 2


@pytest.mark.parametrize("values", [(0.1, 0.2, 0.3), ("amplitude", "power")])
def test_sweep_runs_along_numbers_or_names(values: tuple[Any, ...], tmp_path: Path) -> None:
    points = {value: {"hjb": summaries(20.0), "mfg": summaries(19.0)} for value in values}
    made = comparison.plot_sweep("wind.sigma", points)
    assert len(made.axes) == 4
    assert made.axes[-1].get_xlabel() == "wind.sigma (m/s/√s)"
    assert len(plotstyle.write({"sweep": made}, tmp_path)) == 2


def test_one_seed_has_no_interval_and_still_a_dot() -> None:
    made = comparison.plot_compare({"hjb": summaries(20.0, 1)})
    assert made.axes
    assert made.get_supxlabel() == "one flight each: no interval"


def test_unknown_metric_is_bad_input() -> None:
    with pytest.raises(BadInput, match="nonsense"):
        quantities.number(summaries(1.0)[0], "nonsense")
