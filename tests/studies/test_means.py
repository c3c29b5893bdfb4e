"""Tables of means: honest about who never arrived, with units, and never cut off."""

from typing import Any

import pytest
from rich.console import Console
from rich.table import Column, Table

from meanflock.groundstation.cli.tables import WIDTH, console_for, means_table
from meanflock.studies import study
from meanflock.studies.means import Means
from meanflock.swarm.errors import EXIT_DONE
from meanflock.swarm.scenario import Scenario
from tests.studies.studies import QUICK, flown, rows


def summary(arrived: int, t_avg_s: float | None, uavs: int = 4) -> dict[str, Any]:
    rest = {"energy_mean_J": 2.0, "payload_bits": {"total": 1.5e6}, "phi_A": 1.0, "phi_C_distinct": 1e-3}
    return {"uavs": uavs, "arrived": arrived, "t_avg_s": t_avg_s, "collisions": 0, **rest}


@pytest.mark.parametrize(
    ("arrived", "t_avg_s", "mean_s"), [(4, 30.0, 30.0), (1, 20.0, (20 + 3 * 60) / 4), (0, None, 60.0)]
)
def test_who_never_arrived_counts_with_the_duration(arrived: int, t_avg_s: float | None, mean_s: float) -> None:
    given = summary(arrived, t_avg_s)
    assert study.of_all(Scenario(uavs=4, duration=60.0), given) == {**given, "t_avg_censored_s": mean_s}


@pytest.mark.usefixtures("undrawn")
def test_a_comparison_says_so_in_table_and_csv(run, tmp_path) -> None:
    """A destination so wide that some are there at once, and some on their way when the flight ends."""
    flags = ("--set", "destination.radius=178", "--set", "start.spacing=4", "--uavs", "3", "--seeds", "2")
    code, out, _ = run("compare", "mfg", *flags, *QUICK)
    assert code == EXIT_DONE
    runs = flown(tmp_path / "out")
    arrived = sum(one["arrived"] for one in runs) / 2
    assert 0 < arrived < 3
    expected = sum((one["t_avg_s"] * one["arrived"] + 3.0 * (3 - one["arrived"])) / 3 for one in runs) / 2
    (row,) = rows(tmp_path / "out/compare.csv")
    assert float(row["t_avg_censored_s"]) == pytest.approx(expected)
    assert float(row["arrived_uavs"]) == arrived
    assert row["n"] == "2"
    assert f"{arrived:.4g}/3" in out
    assert f"{expected:.4g}" in out
    assert "counts with the duration" in " ".join(out.split())
    for name in ("compare.png", "compare.svg", "compare.csv", "runs.jsonl"):
        assert f"out/{name}" in out


@pytest.mark.parametrize(
    "key", ["radio.latency_threshold_slots (slots)", "federation.broadcast_payload", "metrics.collision_radius (m)"]
)
def test_a_table_has_units_and_no_name_is_cut_off_at_80_columns(key: str) -> None:

    large = {**summary(25, 161.3456, 25), "t_avg_censored_s": 161.3456, "phi_C_distinct": 1.234567e-5, "phi_A": 1.23456}
    large |= {"energy_mean_J": 148.2859, "payload_bits": {"total": 987_654_321}, "collisions": 99.875}
    points = {(value, method): [large] * 8 for value in (0.125, 1000) for method in ("mfgfl-hf", "offline")}
    console = Console(width=WIDTH)
    with console.capture() as capture:
        console.print(means_table(Means((key, "method"), points), "sweep: 25 UAVs", [300.0]))
    lines = capture.get().splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert "…" not in capture.get()
    for method in ("mfgfl-hf", "offline"):
        assert sum(method in line.split() for line in lines) == 2
    head = "".join(line.split(" ")[0] for line in lines[1 : next(k for k, line in enumerate(lines) if "─" in line)])
    assert head == key.replace(" ", "")
    for unit in ("(UAVs)", "(s)", "(J)", "(Mbit)", "(m/s)", "(1)", "(pairs)"):
        assert unit in capture.get()
    assert "25/25" in capture.get()
    assert "1.235e-05" in capture.get()


@pytest.mark.parametrize("columns", [20, 40, 80, 120])
def test_no_number_of_a_table_is_cut_however_narrow_the_terminal(columns, monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    table = Table(Column("method", no_wrap=True), *(Column(f"quantity {k}", no_wrap=True) for k in range(5)))
    table.add_row("mfgfl-hf", *(f"{1234.5 + k}" for k in range(5)))
    console_for(table).print(table)
    shown = capsys.readouterr().out
    assert "…" not in shown
    assert all(f"{1234.5 + k}" in shown for k in range(5))
    assert "mfgfl-hf" in shown


def test_a_long_value_of_a_sweep_goes_over_several_lines_before_the_table_gets_wider_than_the_terminal(
    monkeypatch, capsys
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    discs = "[{'x': 10.0, 'y': 20.0, 'radius': 3.0}, {'x': 30.0, 'y': 20.0, 'radius': 3.0}]"
    flown = {**summary(25, 161.3456, 25), "t_avg_censored_s": 161.3456}
    shown_table = means_table(Means(("obstacles", "method"), {(discs, "mfgfl-hf"): [flown] * 8}), "sweep", [300.0])
    console_for(shown_table).print(shown_table)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 80
    assert "161.3" in shown
    assert "mfgfl-hf" in shown
    assert all(word in shown for word in discs.split())
