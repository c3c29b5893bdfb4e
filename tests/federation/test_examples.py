"""The examples of federated learning: they fly, and compute what their papers say."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from tests.pages import script_of

IDEAL = {"radio.model": "ideal"}
classifier, fedadam, scaffold = (script_of(name, "examples") for name in ("classifier", "fedadam", "scaffold"))

RULES = {
    "fedadam": fedadam.FedAdam,
    "fedbuff": script_of("fedbuff", "examples").FedBuff,
    "inverse-probability": script_of("inverse_probability", "examples").InverseProbability,
    "scaffold": scaffold.ScaffoldRule,
}


@pytest.mark.parametrize("name", RULES)
def test_the_rules_fly(name: str) -> None:
    plugins.register(RULES[name])
    settings = {"federation.aggregation": name, "federation.fraction": 1.0, "federation.period": 20}
    method = scaffold.Scaffold if name == "scaffold" else "fed-lspi"
    run = mf.fly(method=method, uavs=9, seed=3, duration=20, **settings)
    assert run.summary["rounds"] >= (1 if name == "fedbuff" else 8)
    assert run.summary["rounds"] + run.summary["rounds_void"] <= 9
    assert not [event for event in run.events if "failed" in event["text"]]
    assert run.summary["lost"] == 0


# -- FedAdam, SCAFFOLD, inverse probability -------------------------------------------------------------------------


def test_fedadam_takes_the_step_that_was_worked_by_hand() -> None:
    rule = fedadam.FedAdam(fedadam.FedAdam.Options(eta=0.1, beta1=0.5, beta2=0.75, tau=0.2), mf.Scenario())
    state, model = rule.step(rule.init(2), mf.Uploads.complete(np.array([[1.0, 0.0], [3.0, 0.0]])))
    assert model.tolist() == [2.0, 0.0]
    state, model = rule.step(state, mf.Uploads.complete(np.array([[2.0, -0.4], [3.0, -0.4]]), 2))
    # Δ = [0.5, −0.4]; m = Δ/2; v = 0.75 · 0.04 + 0.25 Δ² = [0.0925, 0.07]; x ← x + 0.1 m / (√v + 0.2)
    expected = [2.0 + 0.1 * 0.25 / (np.sqrt(0.0925) + 0.2), -0.1 * 0.2 / (np.sqrt(0.07) + 0.2)]
    np.testing.assert_allclose(model, expected, rtol=1e-15)
    np.testing.assert_allclose(state["v"], [0.0925, 0.07], rtol=1e-15)


def test_the_control_variates_of_scaffold_have_the_leaders_as_their_mean() -> None:
    """c = Σ c_i / N after every round in which all take part, and s is the mean of the K corrected gradients."""
    plugins.register(scaffold.ScaffoldRule)
    settings = {**IDEAL, "radio.bits_per_float": 64, "federation.fraction": 1.0, "federation.aggregation": "scaffold"}
    seen: list[Any] = []

    class Watched(scaffold.Scaffold):
        name = "watched"

        def step(self, memory: Any, tick: int, own: Any, received: Any) -> Any:
            seen.append((tick, memory))
            return super().step(memory, tick, own, received)

    Engine(mf.Scenario(method=Watched, uavs=6, stop="duration", duration=20, seed=2, **settings), "flight").complete()
    flown = dict(seen)
    for tick in range(29, 200, 20):  # between two rounds
        models, shared = flown[tick]["model"][:, :2], flown[tick]["global"][:, 2:]
        assert np.abs(shared).max() > 1e-4
        np.testing.assert_allclose(flown[tick]["variate"].mean(axis=0), shared[0], atol=1e-15)
        assert len(np.unique(models, axis=0)) == len(np.unique(shared, axis=0)) == 1
    steps = [flown[tick]["model"][:, :2] - flown[tick + 1]["model"][:, :2] for tick in range(50, 60)]
    mean = np.mean(steps, axis=0) / scaffold.RATE
    np.testing.assert_allclose(flown[60]["model"][:, 2:], mean, atol=1e-12)
    before = flown[50]["variate"] - flown[50]["global"][:, 2:]
    np.testing.assert_allclose(flown[61]["variate"], before + mean, atol=1e-12)


def test_the_rule_of_scaffold_moves_by_the_share_of_the_uavs_that_took_part() -> None:
    rule = scaffold.ScaffoldRule(scaffold.ScaffoldRule.Options(), mf.Scenario(uavs=4))
    uploads = mf.Uploads.complete(np.array([[1.0, 1.0, 0.5, 0.0], [3.0, 1.0, 0.7, 0.4]]))
    state, model = rule.step({"shared": np.array([0.2, 0.2])}, uploads)
    np.testing.assert_allclose(model, [2.0, 1.0, 0.2 + 0.5 * (0.6 - 0.2), 0.2], rtol=1e-15)  # |S| = 2 of N = 4
    assert state["shared"].tolist() == model[2:].tolist()


# -- the classifier -----------------------------------------------------------------------------------------------


def test_the_program_prints_a_line_for_each_way_and_writes_a_picture(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["classifier.py", "--rounds", "6", "--uavs", "5"])
    monkeypatch.chdir(tmp_path)
    classifier.main()
    lines = re.findall(r"^(.+): ([\d.]+)% of the tests, .* ([\d.]+) Mbit$", capsys.readouterr().out, re.M)
    assert [way for way, _, _ in lines] == list(classifier.WAYS)
    assert lines[0][2] == "0.0"
    assert float(lines[0][1]) < 25.0 < float(lines[2][1])
    assert Path("out/classifier/accuracy.png").stat().st_size > 10_000


def test_sharing_makes_a_classifier_of_all_digits_and_pays_for_every_fragment() -> None:
    """Twenty rounds, the accuracy of the UAV that is worst; over a radio that loses half of the fragments, too."""
    flown = {way: classifier.fly(way, 10, 20) for way in classifier.WAYS}
    least = {way: rows[-1][1] for way, rows in flown.items()}
    assert least["alone"] <= 0.25
    assert min(least["leader"], least["neighbours"]) >= 0.88
    assert min(least["lossy, leader"], least["lossy, neighbours"]) >= 0.7
    bits = [bits for _, _, bits in flown["neighbours"]]
    assert bits == [bits[1] * number for number in range(21)]
    assert 10 * 32 * 2410 <= bits[1] < 1.1 * 10 * 32 * 2410
