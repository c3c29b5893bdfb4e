"""The key `until`: a flight ends with the round that reaches a bound, and says what it cost to get there."""

import re

import pytest

import meanflock as mf
from meanflock.cli.command import main
from meanflock.federation.plan import plan_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Until, load
from tests.telemetry import fly

FLIGHT = ("uavs=5", "duration=100", 'stop="duration"', "federation.period=50", "federation.fraction=1.0")


def test_a_flight_ends_with_the_round_that_reaches_the_bound_and_says_what_it_cost() -> None:
    case = load(None, FLIGHT, method="mfgfl-hf", seed=3)
    whole = mf.fly(case).rounds().to_pylist()
    values = [row["mean_phi_G"] for row in whole]
    bound = values[len(values) // 2]
    first = next(row for row in whole if row["mean_phi_G"] <= bound)
    ended = mf.fly(case, until=f"phi_G<={bound!r}")
    assert ended.summary["ticks"] == first["tick"] + 1 < case.max_ticks
    cost = ended.summary["until"]
    assert (cost["metric"], cost["value"], cost["reached"], cost["round"]) == ("phi_G", bound, True, first["round"])
    assert (cost["time_s"], cost["bits"], cost["airtime_s"]) == (
        first["sim_time_s"],
        first["bits"],
        first["airtime_s"],
    )
    assert cost["energy_J"] <= ended.summary["energy_total_J"]


def test_a_flight_that_reached_its_bound_has_finished_and_says_so(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ("--uavs=5", "--duration=60", "--set=federation.period=50", "--method=mfgfl-hf", "--in-process")
    for bound, sign, said, told in (
        ("phi_G<=1e9", "≤", "reached", "Round 1 reached phi_G ≤ 1e+09, after 5.1 s and"),
        ("phi_G>=1e9", "≥", "not reached", "No round reached phi_G ≥ 1e+09."),
    ):
        assert main(["run", *flags, "--until", bound, "--no-record", "--quiet"]) == 0
        assert re.search(
            rf"phi_G {sign} 1e\+09 +│ +{said} │ {'in round 1, after 5.1 s' if said == 'reached' else ''}",
            capsys.readouterr().out,
        )
        assert not list(tmp_path.glob("runs/*/checkpoint.msgpack"))
        assert main(["show", "latest"]) == 0
        shown = " ".join(capsys.readouterr().out.split())
        assert told in shown
        assert "interrupted" not in shown


def test_a_bound_that_is_not_reached_costs_nothing_and_changes_nothing() -> None:
    case = load(None, FLIGHT, method="mfgfl-hf", seed=3)
    plain, missed = mf.fly(case).summary, mf.fly(case, until="phi_G>=1e9").summary
    assert plain["until"] is None
    assert (missed["until"]["reached"], missed["until"]["round"], missed["until"]["bits"]) == (False, None, None)
    assert missed["trajectory_sha256"] == plain["trajectory_sha256"]


def test_the_flight_is_the_same_in_any_number_of_nodes() -> None:
    case = load(None, (*FLIGHT, 'until="phi_G<=0.3"'), method="mfgfl-hf", seed=3)
    one, two = fly(case)[0], fly(case, rows=2)[0]
    assert one["until"] == two["until"]
    assert one["ticks"] == two["ticks"]


@pytest.mark.parametrize(
    ("method", "until", "expected"),
    [
        ("mfgfl-hf", "accuracy=0.9", "it reports hjb_residual, fpk_residual, phi_G"),
        ("hjb", "phi_G<=0.3", "take a method or a learner that shares a model"),
        ("mfgfl-hf", "phi_G<0.3", "expected a metric and a bound, as in accuracy=0.9"),
        ("mfgfl-hf", "phi_G=low", "expected a metric and a bound"),
    ],
)
def test_a_bound_that_nothing_reports_is_refused_before_take_off(method: str, until: str, expected: str) -> None:
    with pytest.raises(BadInput, match=expected):
        plan_of(load(None, (f"until={until!r}",), method=method))


def test_a_bound_is_met_from_its_own_side() -> None:
    low, high = Until.of_text("loss <= 0.5"), Until.of_text("accuracy=.5")
    assert [low.is_met(value) for value in (0.4, 0.5, 0.6)] == [True, True, False]
    assert [high.is_met(value) for value in (0.4, 0.5, 0.6)] == [False, True, True]
