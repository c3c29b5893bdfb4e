"""Rounds as a result: one table in memory and in the run folder, in the terminal, and as learning curves."""

import json
from io import StringIO
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from rich.console import Console

import meanflock as mf
from meanflock.cli.command import main
from meanflock.cli.study_tables import rounds_table
from meanflock.results import inbound
from meanflock.results.event_log import past_events, row_of
from meanflock.results.plots.rounds import plot_rounds
from meanflock.results.rounds_table import COLUMNS, OVER, ROUNDS
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.events import RoundEnded
from tests.groundstation.conftest import plain, titles
from tests.telemetry import fly

KEYS = {"uavs": 6, "seed": 3, "duration": 20.0, "stop": "duration", "federation.period": 40}
KEYS |= {"radio.target_snr_db": 76.0}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[mf.Run, mf.Run]:
    """A run and the same, read back."""
    run = mf.fly(method="mfgfl-hf", out=tmp_path_factory.mktemp("rounds"), **KEYS)
    return run, mf.open(run.folder)


def test_the_rounds_of_a_run_are_a_table_that_is_also_in_its_folder(flown: tuple[mf.Run, mf.Run]) -> None:
    run, opened = flown
    table = run.rounds()
    assert table.equals(opened.rounds())
    assert table.equals(pq.read_table(run.folder / ROUNDS))
    assert table.column_names[: len(COLUMNS)] == list(COLUMNS)
    rows = table.to_pylist()
    averaged = [row for row in rows if row["outcome"] == "averaged"]
    assert (len(averaged), len(rows)) == (run.summary["rounds"], run.summary["rounds"] + run.summary["rounds_void"])
    uplink = run.summary["radio"]["traffic"]["uplink"]
    assert sum(row["copies"] for row in rows) == uplink["sent"]  # a model of the leader to itself needs no radio
    assert sum(row["lost"] for row in rows) == uplink["outages"] > 0
    assert [row["opened_s"] for row in rows] == [4.0 * row["round"] for row in rows]
    assert all(row["sent"] == row["received"] + row["late"] + row["lost"] for row in rows)


def test_costs_of_a_round_are_those_of_the_series_and_its_means_those_of_the_uavs_on_the_way(flown) -> None:
    run, _ = flown
    rows, series = run.rounds().to_pylist(), run.frame()
    for row in rows:
        after = series.slice(row["tick"] + 1, 1).to_pylist()[0]  # the row of a tick is at its end
        assert row["bits"] == sum(after[f"{kind}_bits"] for kind in ("uplink", "relay", "broadcast", "state"))
        assert row["airtime_s"] == after["airtime_s"]
        assert set(after["status"]) == {0}  # all are on the way
        assert row["mean_hjb_residual"] == pytest.approx(sum(after["hjb_residual"]) / 6, rel=1e-6)
    assert [row["bits"] for row in rows] == sorted(row["bits"] for row in rows)


def test_a_run_without_rounds_has_an_empty_table_no_file_and_no_learning_curve(tmp_path: Path, capsys) -> None:
    run = mf.fly(method="hjb", uavs=2, duration=1.0, out=tmp_path)
    assert (run.rounds().num_rows, (run.folder / ROUNDS).exists()) == (0, False)
    assert main(["show", str(run.folder), "--rounds"]) == 0
    says = "the run has no rounds; fly a method that shares a model, as mfgfl-hf does, until a round ends"
    assert says in capsys.readouterr().out
    assert main(["plot", str(run.folder), "--over", "bits"]) == 2
    assert says in capsys.readouterr().err


def test_the_terminal_shows_a_line_a_round_in_80_columns(flown: tuple[mf.Run, mf.Run], monkeypatch, capsys) -> None:
    run, _ = flown
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["show", str(run.folder), "--rounds"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    heads = " ".join(" ".join(lines).split())
    assert "residual residual action" in heads
    assert "(m/s) (1/s) (1/s²)" in heads
    assert "hjb_residual" not in heads
    assert sum(line.split()[:1] == [str(row["round"])] for line in lines for row in run.rounds().to_pylist()) == 4
    assert main(["show", str(run.folder), "--rounds", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == run.rounds().to_pylist()


def test_rounds_without_a_leader_say_how_many_uavs_averaged(
    flown: tuple[mf.Run, mf.Run], tmp_path: Path, capsys
) -> None:
    led, _ = flown
    assert set(led.rounds()["averaging"].to_pylist()) == {None}
    assert main(["show", str(led.folder), "--rounds"]) == 0
    assert "averaging" not in capsys.readouterr().out
    near = mf.fly(method="mfgfl-hf", out=tmp_path, **KEYS | {"federation.topology": "neighbours"})
    rows = near.rounds().to_pylist()
    assert all(0 < row["averaging"] == 6 - row["isolated"] for row in rows)
    assert main(["show", str(near.folder), "--rounds"]) == 0
    assert "averaging" in capsys.readouterr().out


@pytest.mark.parametrize("over", OVER)
def test_learning_curves_are_drawn_over_each_cost(over: str, flown: tuple[mf.Run, mf.Run], capsys) -> None:
    run, _ = flown
    assert main(["plot", str(run.folder), "--over", over]) == 0
    assert (run.folder / "plots" / f"learning-over-{over}.svg").stat().st_size > 1000
    (figure,) = plot_rounds(run.folder, over).values()
    assert [plain(title) for title in titles(figure)] == [
        "mean HJB residual e_H",
        "mean FPK residual e_F",
        "mean interaction term φ_G",
    ]
    assert [plain(ax.get_ylabel()) for ax in figure.axes[:3]] == ["e_H (m/s)", "e_F (1/s)", "φ_G (1/s²)"]
    assert {ax.get_xlabel() for ax in figure.axes[:3]} == {
        {"rounds": "round", "seconds": "time (s)", "bits": "payload (bits)", "airtime": "airtime (s)"}[over]
    }


@pytest.mark.parametrize(
    ("fields", "reason"),
    [({"sent": (0, 6)}, "wrong-shape"), ({"late": (99,)}, "wrong-shape"), ({"airtime_s": float("nan")}, "non-finite"),
     ({"metrics": {"loss": float("inf")}}, "non-finite")],
)  # fmt: skip
def test_a_false_round_is_refused_by_the_station(fields: dict, reason: str) -> None:
    _, record = fly(mf.Scenario(uavs=6, duration=1.0, method="mfg"))
    false = msgspec.structs.replace(record.blocks[0], events=(RoundEnded(1, 1, 0, "averaged", **fields),))
    with pytest.raises(MessageRejected) as rejected:
        inbound.check(false, 6)
    assert rejected.value.reason == reason


@pytest.mark.parametrize("field", ["sent", "received", "late", "refused"])
def test_no_flight_continues_after_a_round_of_uavs_that_are_not_there(field: str, tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    ended = RoundEnded(1, 1, 0, "averaged", **{field: (0, 5)})
    path.write_text(json.dumps(row_of(ended, 0.1)) + "\n")
    size = path.stat().st_size
    assert [event.text for event in past_events(path, size, 6, "")] == [ended.text]
    with pytest.raises(BadInput, match=r"damaged .*UAVs \(0, 5\)"):
        past_events(path, size, 5, "")


def test_a_comparison_has_the_rounds_and_what_was_learned_at_the_end_of_the_last(tmp_path: Path) -> None:
    death = {"kind": "kill", "tick": 60, "uavs": [0]}
    settings = {"uavs": 5, "duration": 9.0, "federation.period": 40, "faults": [death]}
    compared = mf.compare(["mfgfl-h", "plan"], seeds=2, jobs=1, out=tmp_path, **settings)
    flown, without = compared
    last = [mf.fly(method="mfgfl-h", seed=seed, **settings).rounds().to_pylist() for seed in (1, 2)]
    averaged = [[row for row in rows if row["outcome"] == "averaged"][-1] for rows in last]
    assert (flown["rounds"], flown["rounds_void"], flown["last_round_n"]) == (1.0, 1.0, 2)
    for name in ("round", "bits", "airtime_s", "mean_phi_G"):
        assert flown[f"last_round_{name}"] == pytest.approx(np.mean([row[name] for row in averaged]))
    assert flown["last_round_mean_phi_G_low"] < flown["last_round_mean_phi_G"] < flown["last_round_mean_phi_G_high"]
    assert flown.keys() == without.keys()
    assert (without["rounds"], without["last_round_n"], without["last_round_mean_phi_G"]) == (0.0, 0, None)
    table = compared.frame()
    assert table["last_round.mean_phi_G"].to_pylist() == [*(row["mean_phi_G"] for row in averaged), None, None]
    text = StringIO()
    Console(file=text, width=80).print(rounds_table(compared.means))
    assert "φ_G" in text.getvalue()
    assert "mean_" not in text.getvalue()
    assert rounds_table(mf.compare("plan", seeds=1, jobs=1, uavs=2, duration=1.0).means) is None
