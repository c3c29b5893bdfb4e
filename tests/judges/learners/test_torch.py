"""Learners in PyTorch fly in one process and in many, with the same bits. `make learners` has the environment."""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="make learners")
pytest.importorskip("torch._dynamo")  # it sets a variable, which a test must not

import meanflock as mf  # noqa: E402
from meanflock.swarm.plugins import registry  # noqa: E402
from meanflock.testing import check_learner  # noqa: E402
from meanflock.torch import TorchLearner  # noqa: E402
from tests.commands import printed  # noqa: E402
from tests.sources import ROOT  # noqa: E402

DIGITS = ROOT / "examples" / "digits.py"
FLOWN = ("--method", "orca", "--uavs", "10", "--duration", "20", "--no-record", "--json", "--quiet")
SETTINGS = ("federation.fraction=1", "federation.period=20", "stop=duration")


@pytest.fixture(autouse=True)
def _unregistered() -> Iterator[None]:
    before = dict(registry.registered)
    yield
    registry.registered.clear()
    registry.registered.update(before)


def summary(out: Path, *flags: str, **variables: str) -> dict[str, Any]:
    settings = (part for setting in SETTINGS for part in ("--set", setting))
    command = ("-m", "meanflock", "run", "--learner", DIGITS, *FLOWN, *settings, "--out", out, *flags)
    said = printed(sys.executable, *command, env=os.environ | {"PYTHONPATH": str(ROOT)} | variables, timeout=240)
    return json.loads(said)


def test_ten_learners_have_the_same_models_in_one_process_in_two_and_in_ten(tmp_path: Path) -> None:
    one, two, ten = (
        summary(tmp_path, *flags) for flags in (("--in-process",), ("--uavs-per-process", "5"), ("--metrics", "0"))
    )
    assert one["lost"] == two["lost"] == ten["lost"] == 0
    assert one["rounds"] == 9
    for key in ("models_sha256", "trajectory_sha256", "payload_bits", "diagnostics"):
        assert one[key] == two[key] == ten[key], key


def test_other_kernels_of_torch_are_refused_unless_the_scenario_names_them(tmp_path: Path) -> None:
    if "AVX2" not in torch.__config__.show() and torch.backends.cpu.get_cpu_capability() == "NO AVX":
        pytest.skip("a processor without AVX2")
    flags = ("--in-process", "--set", "training.torch_isa=avx2")
    assert summary(tmp_path, *flags, ATEN_CPU_CAPABILITY="avx2")["lost"] == 0
    with pytest.raises(AssertionError, match=r"kernels 'avx2', and `training.torch_isa` is 'default'"):
        summary(tmp_path, "--in-process", ATEN_CPU_CAPABILITY="avx2")


class Blobs(TorchLearner):
    """Two clouds of points, with batch normalisation, dropout and a personal head."""

    name = "blobs"
    metrics = ("loss", "accuracy")
    keeps_optimizer = True
    keeps = ("3.*",)

    def module(self) -> Any:
        return torch.nn.Sequential(
            torch.nn.Linear(4, 8), torch.nn.BatchNorm1d(8), torch.nn.Dropout(0.1), torch.nn.Linear(8, 2)
        )

    def optimizer(self, parameters: Any) -> Any:
        return torch.optim.Adam(parameters, lr=0.01)

    def data(self) -> Any:
        inputs = torch.randn(64, 4)
        return torch.utils.data.TensorDataset(inputs, (inputs.sum(1) > 0).long())


def test_buffers_optimisers_and_personal_layers_are_in_the_checkpoint() -> None:
    check_learner(Blobs)


def test_a_frozen_network_is_not_sent() -> None:
    class Adapted(Blobs):
        name = "adapted"
        keeps = ()
        keeps_optimizer = False

        def module(self) -> Any:
            net = torch.nn.Sequential(torch.nn.Linear(4, 1000), torch.nn.Tanh(), torch.nn.Linear(1000, 2))
            return net.requires_grad_(False).add_module("adapter", torch.nn.Linear(2, 2)) or net

    check_learner(Adapted)
    run = mf.fly(learner=Adapted, method="plan", uavs=3, duration=25, **{"federation.period": 100})
    traffic = run.summary["radio"]["traffic"]["uplink"]
    assert traffic["payload_bits"] == traffic["transmissions"] * 32 * (6 + 1 + 2)  # with a weight and a head


def test_bfloat16_travels_as_float32() -> None:
    class Half(Blobs):
        name = "half"
        keeps = ()
        keeps_optimizer = False

        def module(self) -> Any:
            return torch.nn.Linear(4, 2).to(torch.bfloat16)

        def data(self) -> Any:
            inputs = torch.randn(64, 4)
            return torch.utils.data.TensorDataset(inputs.to(torch.bfloat16), (inputs.sum(1) > 0).long())

    check_learner(Half)


@pytest.mark.parametrize("missing", ["module", "optimizer", "data"])
def test_a_method_that_is_not_overridden_is_named(missing: str) -> None:
    left = {name: method for name, method in vars(Blobs).items() if name != missing}
    left["keeps_optimizer"] = False
    with pytest.raises(mf.BadInput, match=f"learner 'blobs': .*NotImplementedError: override `{missing}`"):
        mf.fly(method="orca", learner=type("Lacking", (TorchLearner,), left), uavs=2, duration=1)


def test_data_that_are_no_data_set_are_refused() -> None:
    with pytest.raises(mf.BadInput, match="TypeError: `data` returns a NoneType; expected a data set"):
        mf.fly(method="orca", learner=type("None", (Blobs,), {"data": lambda self: None}), uavs=2, duration=1)


def test_a_uav_without_examples_sends_nothing_and_is_not_lost() -> None:
    def data(self: Any) -> Any:
        inputs = torch.randn(64 * (self.uav != 1), 4)
        return torch.utils.data.TensorDataset(inputs, (inputs.sum(1) > 0).long())

    settings = {"federation.fraction": 1.0, "federation.period": 20, "radio.model": "ideal"}
    run = mf.fly(method="orca", learner=type("Unequal", (Blobs,), {"data": data}), uavs=4, duration=9, **settings)
    assert run.summary["lost"] == 0
    assert [(row["sent"], row["mean_examples"]) for row in run.rounds().to_pylist()] == [(3, 64.0)] * 4
