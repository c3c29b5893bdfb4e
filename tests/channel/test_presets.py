"""Radios of scenarios: their flights, `--radio`, what `scenario show` says of them, and links beyond a source."""

import json
from pathlib import Path
from typing import Any

import pytest

from meanflock.channel.remarks import remarks
from meanflock.cli.command import main
from meanflock.launch.engine import Engine
from meanflock.swarm import toml
from meanflock.swarm.scenario import load
from tests.faults.dying import LATER, dead, resumed, steady

PRESETS = ("radio-mast", "radio-sky", "radio-street", "radio-thin")


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_the_same_in_nodes_and_after_a_kill(name: str, tmp_path: Path) -> None:
    flown = load(toml.found(Path(name)), ["uavs=9", LATER])
    whole = Engine(flown, "whole").complete()
    assert (whole["rounds"], whole["rounds_void"], whole["uploads_late"]) == (1, 0, 0)
    but = "run_id", "wire_bytes", "radio"
    assert steady(Engine(flown, "nodes", uavs_per_node=2).complete(), *but) == steady(whole, *but)
    end = resumed(dead(tmp_path, flown, 210, rows=4), "--uavs-per-process", "4")
    assert end["models_sha256"] == whole["models_sha256"]
    assert end["radio"]["airtime_s"] == whole["radio"]["airtime_s"]


def shown(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["scenario", "show", *arguments]) == 0
    return capsys.readouterr().out


def test_another_scenarios_radio_is_flown_whole_and_set_overrides_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    own = tmp_path / "own.toml"
    own.write_text('[radio]\nmodel = "ideal"\nrange_m = 7.0\n[start]\nheight = 90.0\nradius = 3.0\n')
    expected = load(toml.found(Path("radio-sky"))).radio
    flown = tmp_path / "flown.toml"
    for arguments, radio, height in (
        (("lossy", "--radio", "radio-sky"), expected, 40.0),
        (("swap", "--radio", str(own)), load(own).radio, 90.0),
    ):
        flown.write_text(shown(capsys, *arguments))
        assert (load(flown).radio, load(flown).start.height) == (radio, height)
    assert load(flown).start.formation == "circle"
    flown.write_text(shown(capsys, "--radio", "radio-sky", "--set", "radio.access=fdma", "--set", "start.height=60"))
    assert (load(flown).radio.access, load(flown).radio.model, load(flown).start.height) == ("fdma", "link-budget", 60)
    assert main(["scenario", "show", "--radio", "nowhere"]) == 2


def test_a_scenario_is_shown_with_what_its_radio_can_do(capsys: pytest.CaptureFixture[str]) -> None:
    paper, sky = (list(remarks(load(None if name is None else toml.found(Path(name))))) for name in (None, "radio-sky"))
    assert "24.9 bit/s/Hz" in paper[0]
    assert paper[-1].startswith("the paper's; 24.9 bit/s/Hz is more than radios reach")
    assert "1.48 bit/s/Hz" in sky[0]
    assert sky[1].startswith("between UAVs at 100 m: margin 39.2 dB, 0 % of messages")  # 43.9 dB less 4.7 dB of CQI 7
    assert len(sky) == 4
    quiet = remarks(load(None, ["radio.noise_psd_dbm_hz=-190"]))
    assert list(quiet)[-1] == "a noise of -190 dBm/Hz is below that of a resistor, -174 dBm/Hz"
    assert shown(capsys).splitlines()[: len(paper)] == [f"# {line}" for line in paper]


def test_links_beyond_the_source_of_a_path_loss_are_counted_and_told_once(tmp_path: Path) -> None:
    settings = ("radio.options.air_loss=air-to-air", "start.height=50", "destination.radius=0.1", "uavs=4")
    apart = ("radio.range_m=1e6",)
    flown = load(toml.found(Path("radio-sky")), [*settings, *apart, "duration=20"], method="hjb")
    assert Engine(flown, "near").complete()["radio"]["clamped"] == 0
    told: list[Any] = []

    class Ear:
        def write(self, block: Any) -> None:
            told.extend(event for event in block.events if event.kind == "clamped")

    engine = Engine(flown, "far", sinks=[Ear()])  # type: ignore[list-item]
    engine.world.flight.states[0, 0] = 1e5  # as after a long flight
    summary = engine.complete()
    assert summary["radio"]["clamped"] > 200
    assert [event.links for event in told] == [3]
    assert json.dumps(summary)
