"""A warning before take-off of models that the radio will lose."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import meanflock as mf
from meanflock.channel.outlook import outlooks, remedies
from meanflock.groundstation.cli.command import main
from meanflock.swarm import toml
from meanflock.swarm.scenario import load
from meanflock.testing import check_controller
from tests.agent.large_model import Large

LARGE = str(Path(__file__).parents[1] / "agent" / "large_model.py")
WARNING = "an upload of 19,200 bits takes 8 slots; the limit is 8: 97.4 % will be lost. Use federation.fragment=3"


@pytest.mark.parametrize("settings", [("federation.payload=int8",), ("federation.clusters=4",)])
def test_the_expected_share_is_the_share_lost(settings: tuple[str, ...]) -> None:
    fixed = ["federation.fraction=1.0", "duration=2", "federation.period=3", "radio.path_loss_exponent=0.02"]
    flown = load(None, [*fixed, *settings], method="mfgfl-hf")
    runs = [mf.fly(flown, seed=seed).summary["radio"]["traffic"] for seed in range(6)]
    names = {"upload": "uplink", "relay": "relay", "global model": "broadcast"}
    for one in outlooks(flown):
        bills = [run[names[one.message]] for run in runs]
        sent, lost = sum(bill["sent"] for bill in bills), sum(bill["outages"] for bill in bills)
        assert abs(lost / sent - one.lost) < 4.0 * np.sqrt(one.lost / sent) + 0.01


def test_every_remedy_helps_alone() -> None:
    mf.register(Large)
    flown = load(None, method="large")
    for one in outlooks(flown):
        settings = re.findall(r"(\S+=\S+) \(([\d.]+) % lost\)", remedies(flown, one.message))
        assert len(settings) == 3
        for setting, share in settings:
            changed = next(
                other for other in outlooks(load(None, [setting], method="large")) if other.message == one.message
            )
            assert 100 * changed.lost == pytest.approx(float(share), rel=0.05)
            assert changed.lost < 0.2 < one.lost


def test_where_fragments_get_through_no_longer_wait_is_advised() -> None:
    mf.register(Large)
    lossy = toml.FOLDER / "lossy.toml"
    for one in outlooks(flown := load(lossy, method="large")):
        assert one.is_bad
        assert remedies(flown, one.message) == "Use federation.fragment=1 (50 % lost) or fewer parameters"
    for one in outlooks(load(lossy, ["federation.fragment=1"], method="large")):
        assert one.fragments == 8
        assert not one.is_bad
    short = load(lossy, method="fed-lspi")  # one slot, which nothing cuts
    assert "radio.latency_threshold_slots=20" in remedies(short, "upload")


SHORT = ["--quiet", "--duration", "1", "--plugin", LARGE]
STUDY = ["--seeds", "1", "--jobs", "1", *SHORT]


@pytest.mark.parametrize(
    "command",
    [
        ["run", "--in-process", "--no-record", "--json", *SHORT, "--method", "large"],
        ["compare", "large", "cruise", *STUDY],
        ["sweep", "wind.sigma=0.1,0.2", "--methods", "large", *STUDY],
        ["doctor", "--plugin", LARGE, "--method", "large"],
    ],
    ids=lambda command: command[0],
)
def test_every_command_that_flies_warns_before_take_off(command, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda *_, **__: None)  # to draw takes longer than to fly
    monkeypatch.setenv("COLUMNS", "1000")
    main(command)
    out, err = capsys.readouterr()
    text = out if command[0] == "doctor" else err
    assert "12 % lost" in text
    assert (WARNING if command[0] != "doctor" else "takes 8 slots") in text


@pytest.mark.parametrize("fly", [lambda: mf.fly(method=Large, duration=1.0), lambda: check_controller(Large)])
def test_python_warns_before_take_off(fly: Callable[[], object], capsys: pytest.CaptureFixture[str]) -> None:
    fly()
    assert WARNING in capsys.readouterr().err


def test_a_flight_that_federated_nothing_says_so(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ["--in-process", "--no-record", "--quiet", "--duration", "30"]
    assert main(["run", *flags, "--plugin", LARGE, "--method", "large"]) == 0
    assert "nothing was federated" in capsys.readouterr().err
    assert main(["run", *flags, "--method", "mfgfl-h"]) == 0
    assert "federated" not in capsys.readouterr().err
