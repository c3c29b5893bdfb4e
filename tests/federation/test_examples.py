"""The examples of federated learning: they fly, conform, and compute what their papers say."""

import argparse
import importlib.util
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.groundstation.launch.engine import Engine
from meanflock.testing import check_controller
from tests.telemetry import fly

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str) -> ModuleType:
    """The file of an example, imported."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


classifier = example("classifier")


# -- the classifier -----------------------------------------------------------------------------------------------


def test_the_classifier_conforms() -> None:
    check_controller(classifier.Classifier, {"steps": 12, "batch": 4})
    check_controller(classifier.Classifier, {"share": False})


def test_uavs_hold_two_digits_each_and_no_picture_twice_or_for_tests() -> None:
    brightness, digits = classifier.pictures()
    assert np.bincount(digits).tolist() == [178, 182, 177, 183, 181, 182, 181, 179, 174, 180]
    assert (brightness.min(), brightness.max()) == (0.0, 1.0)
    for uavs in (3, 10, 25):
        held = [classifier.training(uav, uavs) for uav in range(uavs)]
        assert all(len(set(digits[numbers])) == 2 for numbers in held)
        together = np.concatenate(held)
        assert len(together) == len(set(together.tolist()))
        assert (together % 5 > 0).all()
    assert len(together) == np.count_nonzero(np.arange(len(digits)) % 5)


def test_the_gradient_of_a_model_is_right_and_has_the_same_bits_beside_others() -> None:
    draw = np.random.default_rng(1)
    models, inputs, digits = draw.normal(size=(25, 2410)), draw.random((25, 32, 64)), draw.integers(10, size=(25, 32))
    found = classifier.gradient(models, inputs, digits)
    for row in range(25):
        one = slice(row, row + 1)
        assert classifier.gradient(models[one], inputs[one], digits[one]).tobytes() == found[one].tobytes()

    def loss(models: np.ndarray) -> Any:
        outputs = classifier.forward(models, inputs)[1]
        shifted = outputs - outputs.max(axis=2, keepdims=True)
        right = np.take_along_axis(shifted, digits[:, :, None], axis=2)[:, :, 0]
        return (np.log(np.exp(shifted).sum(axis=2)) - right).mean(axis=1)

    for weight in (0, 1000, 2050, 2090, 2405):  # of every layer and offset
        aside = np.zeros(2410)
        aside[weight] = 1e-6
        slope = (loss(models + aside) - loss(models - aside)) / 2e-6
        np.testing.assert_allclose(found[:, weight], slope, atol=1e-7)


IDEAL = {"radio.model": "ideal"}


def test_the_classifier_flies_the_same_alone_in_its_process_and_beside_others() -> None:
    flown = mf.Scenario(method=classifier.Classifier, uavs=5, stop="duration", duration=6.1, **IDEAL)
    (one, record), (many, also) = fly(flown), fly(flown, rows=1)
    assert one["trajectory_sha256"] == many["trajectory_sha256"]
    assert one["diagnostics"] == many["diagnostics"]
    assert one["weight_spread_final"] == many["weight_spread_final"] > 0.0
    for block, its in zip(record.blocks, also.blocks, strict=True):
        assert block.reports.tobytes() == its.reports.tobytes()


def test_the_global_models_are_those_of_federated_averaging() -> None:
    """Four rounds, step by step: none of the training is lost to the round that is under way."""
    settings = {**IDEAL, "radio.bits_per_float": 64, "federation.fraction": 1.0}
    flown = mf.Scenario(method=classifier.Classifier, uavs=4, stop="duration", duration=100, **settings)
    made = classifier.Classifier(classifier.Classifier.Options(), flown)
    model = made.init(np.arange(4), np.zeros((4, 4)))["model"]
    pictures, digits = classifier.pictures()
    engine = Engine(flown, "flight")
    ticks = engine.fly()
    for number in range(1, 5):
        for tick in range(20 * number - 10, 20 * number):
            batch = np.stack([made.batch(uav, tick) for uav in range(4)])
            model = model - made.options.rate * classifier.gradient(model, pictures[batch], digits[batch])
        model = np.tile(model.mean(axis=0), (4, 1))
        while next(ticks) < 20 * number + 10:
            pass
        np.testing.assert_allclose(engine.models, model, rtol=0.0, atol=1e-12)


def test_the_program_writes_a_table_numbers_and_a_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--rounds", "6", "--uavs", "5", "--ways", "alone", "neighbours", "--set", "radio.model=ideal"]
    monkeypatch.setattr("sys.argv", ["classifier.py", *arguments, "--out", str(tmp_path / "out")])
    assert classifier.main() == 0
    said = capsys.readouterr()
    assert "neighbours: 71 %" in said.err
    assert said.out == (tmp_path / "out" / "classifier.md").read_text(encoding="utf-8")
    flown = json.loads((tmp_path / "out" / "classifier.json").read_text(encoding="utf-8"))
    assert [row["round"] for row in flown["neighbours"]] == list(range(7))
    assert [row["bits"] for row in flown["neighbours"]] == [5 * 32 * 2410 * number for number in range(7)]
    assert flown["alone"][6]["accuracy"] < 0.25 < flown["neighbours"][6]["accuracy"]
    assert (tmp_path / "out" / "classifier.png").stat().st_size > 10_000


def test_the_program_keeps_what_was_flown_when_it_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[str] = []

    def fly_one(way: str, *_: Any) -> list[dict[str, float]]:
        if flown:
            raise KeyboardInterrupt
        flown.append(way)
        return [{"round": 0, "accuracy": 0.1, "bits": 0}]

    monkeypatch.setattr(classifier, "fly", fly_one)
    monkeypatch.setattr("sys.argv", ["classifier.py", "--out", str(tmp_path)])
    assert classifier.main() == 130
    assert list(json.loads((tmp_path / "classifier.json").read_text(encoding="utf-8"))) == flown == ["alone"]


def test_sharing_makes_a_classifier_of_all_digits() -> None:
    """Forty rounds over a radio that loses nothing."""
    given = argparse.Namespace(uavs=10, rounds=40, seed=1, set=list(IDEAL.items()))
    (alone, leader, neighbours) = (
        classifier.fly(way, given, lambda _text: None)[-1]["accuracy_min"] for way in ("alone", "leader", "neighbours")
    )
    assert alone <= 0.25
    assert min(leader, neighbours) >= 0.9
