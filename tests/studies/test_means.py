"""Tables: UAVs that never arrived, units, the width of the terminal, and the parts of pages that programs write."""

from typing import Any

import pytest

from meanflock.groundstation.cli.tables import console_for, means_table, payload_table
from meanflock.studies import study
from meanflock.studies.markdown import replaced, table
from meanflock.studies.means import Means
from meanflock.swarm.errors import EXIT_DONE
from meanflock.swarm.scenario import Scenario
from tests.studies.conftest import QUICK, flown, rows


def payload(uplink: int, state: int) -> dict[str, int]:
    return {"uplink": uplink, "relay": 0, "broadcast": 0, "state": state, "total": uplink + state}


def summary(arrived: int, t_avg_s: float | None, **more: Any) -> dict[str, Any]:
    rest = {"energy_mean_J": 2.0, "payload_bits": payload(10**6, 500_000), "phi_A": 1.0, "phi_C_distinct": 1e-3}
    return {"uavs": 4, "arrived": arrived, "t_avg_s": t_avg_s, "collisions": 0, **rest, **more}


@pytest.mark.parametrize(
    ("arrived", "t_avg_s", "mean_s"), [(4, 30.0, 30.0), (1, 20.0, (20 + 3 * 60) / 4), (0, None, 60.0)]
)
def test_a_uav_that_never_arrived_counts_with_the_duration(arrived: int, t_avg_s: float | None, mean_s: float) -> None:
    given = summary(arrived, t_avg_s)
    assert study.of_all(Scenario(uavs=4, duration=60.0), given) == {**given, "t_avg_censored_s": mean_s}


@pytest.mark.usefixtures("undrawn")
def test_table_and_csv_have_the_means_of_the_flights(run, tmp_path) -> None:
    """The destination is so wide that some UAVs arrive at once and others are on their way at the end."""
    flags = ("--set", "destination.radius=178", "--set", "start.spacing=4", "--uavs", "3", "--seeds", "2")
    code, out, _ = run("compare", "mfg", *flags, *QUICK)
    assert code == EXIT_DONE
    runs = flown(tmp_path / "out")
    arrived = sum(one["arrived"] for one in runs) / 2
    assert 0 < arrived < 3
    expected = sum((one["t_avg_s"] * one["arrived"] + 3.0 * (3 - one["arrived"])) / 3 for one in runs) / 2
    (row,) = rows(tmp_path / "out/compare.csv")
    assert float(row["t_avg_censored_s"]) == pytest.approx(expected)
    assert (float(row["arrived_uavs"]), row["n"]) == (arrived, "2")
    for words in (f"{arrived:.4g}/3", f"{expected:.4g}", "counts with the duration"):
        assert words in " ".join(out.split())
    for name in ("compare.png", "compare.svg", "compare.csv", "runs.jsonl"):
        assert f"out/{name}" in out


LARGE = summary(
    25, 161.3456, uavs=25, t_avg_censored_s=161.3456, phi_C_distinct=1.234567e-5, phi_A=1.23456, collisions=99.875
) | {"energy_mean_J": 148.2859, "payload_bits": payload(900_000_000, 87_654_321)}
DISCS = "[{'x': 10.0, 'y': 20.0, 'radius': 3.0}, {'x': 30.0, 'y': 20.0, 'radius': 3.0}]"


@pytest.mark.parametrize("columns", [20, 80])
@pytest.mark.parametrize(
    ("key", "values"), [("federation.broadcast_payload", ("float16", "int8")), ("obstacles", ("[]", DISCS))]
)
def test_a_table_of_means_fits_80_columns_and_cuts_no_number(key, values, columns, monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    points = {(value, method): [LARGE] * 8 for value in values for method in ("mfgfl-hf", "offline")}
    means = Means((key, "method"), points)
    by_kind = payload_table(means)
    console_for(by_kind).print(by_kind)
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= max(80, columns)
    assert "relay" not in shown
    assert all(word in shown for word in ("uplink", "state", "(Mbit)", "87.65"))
    table = means_table(means, "sweep: 25 UAVs", [300.0])
    console_for(table).print(table)
    shown = capsys.readouterr().out
    lines = shown.splitlines()
    assert max(map(len, lines)) <= max(80, columns)
    assert "…" not in shown
    assert all(sum(method in line.split() for line in lines) == 2 for method in ("mfgfl-hf", "offline"))
    assert all(word in shown for value in values for word in str(value).split())
    for word in ("(UAVs)", "(s)", "(J)", "(Mbit)", "(m/s)", "(1)", "(pairs)", "25/25", "1.235e-05", "161.3"):
        assert word in shown


def test_a_cell_breaks_no_table() -> None:
    assert table(("a", "b"), [("|x|", "two\nlines")]) == ["| a | b |", "|---|---|", "| \\|x\\| | two lines |"]


def test_only_the_text_between_its_two_marks_is_replaced() -> None:
    page = "# A page\n<!-- a -->\nold\n<!-- end -->\n<!-- b -->\nkept\n<!-- end -->\n"
    assert replaced(page, "<!-- a -->", "<!-- end -->", ["new"]) == page.replace("old", "new")
    for wrong in ("# A page\n", "<!-- a -->", "<!-- a --><!-- end --><!-- a --><!-- end -->"):
        with pytest.raises(ValueError, match=r"places for `<!-- a -->`"):
            replaced(wrong, "<!-- a -->", "<!-- end -->", [])
