"""Plots of runs, comparisons and sweeps."""

import shutil
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.options import Options
from meanflock.groundstation.launch.run import fly
from meanflock.groundstation.plots import comparison, plotstyle
from meanflock.groundstation.plots.run import plot_run
from meanflock.swarm.errors import EXIT_BAD_INPUT
from meanflock.swarm.scenario import load
from tests.groundstation.conftest import every_axis


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    flown = load(None, method="mfgfl-h", uavs=4, duration=20.0)
    return fly(flown, Options(out=tmp_path_factory.mktemp("runs"), in_process=True, record=False, quiet=True)).folder


def test_a_run_is_plotted_with_the_same_bytes_under_any_matplotlibrc(run_folder: Path, tmp_path: Path) -> None:
    with (run_folder / "events.jsonl").open("a") as events:
        events.write('{"tick": 3, "kind": "coll')  # the last line was cut off
    figures = plot_run(run_folder)
    ours = plotstyle.write(figures, tmp_path / "ours")
    assert [path.name for path in ours] == [f"{name}.{kind}" for name in figures for kind in ("png", "svg")]
    assert set(figures) == {"paths", "curves"}
    assert all(map(every_axis, figures.values()))
    with mpl.rc_context({"axes.facecolor": "red", "savefig.facecolor": "red", "legend.loc": "center"}):
        theirs = plotstyle.write(plot_run(run_folder), tmp_path / "theirs")
    assert [path.read_bytes() for path in theirs] == [path.read_bytes() for path in ours]


@pytest.mark.parametrize(("left", "says"), [(900, "damaged: "), (0, "No such file")])
def test_a_damaged_time_series_is_bad_input_with_a_remedy(left: int, says: str, run_folder, tmp_path, capsys) -> None:
    folder = Path(shutil.copytree(run_folder, tmp_path / "run"))
    path = folder / "timeseries.parquet"
    kept = path.read_bytes()[:left]
    path.unlink()
    if kept:
        path.write_bytes(kept)
    assert main(["plot", str(folder)]) == EXIT_BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    again = f"bring the file back, or fly the run again with `meanflock run {folder / 'scenario.toml'}`"
    assert line.startswith(f"error: {path}: {says}")
    assert again in line


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


@pytest.mark.parametrize("values", [(0.1, 0.2, 0.3), ("amplitude", "power")])
def test_a_sweep_is_drawn_along_numbers_or_names(values: tuple[Any, ...], tmp_path: Path) -> None:
    points = {value: {"hjb": summaries(20.0), "mfg": summaries(19.0)} for value in values}
    figure = comparison.plot_sweep("wind.sigma", points)
    assert len(figure.axes) == 4
    assert figure.axes[-1].get_xlabel() == "wind.sigma (m/s/√s)"
    assert len(plotstyle.write({"sweep": figure}, tmp_path)) == 2
