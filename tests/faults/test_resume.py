"""A run that died goes on from its last checkpoint to the end it would have had, bit for bit."""

import os
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.resume import back
from meanflock.groundstation.results.run_folder import RunFolder
from tests.faults.conftest import Lab, scenario
from tests.faults.dying import LATER, dead, events, flight, resumed, steady


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return flight(tmp_path_factory.mktemp("undisturbed"), scenario(LATER))


def test_a_run_can_die_and_be_resumed_again_and_again(undisturbed: dict[str, Any], tmp_path: Path) -> None:
    flown = scenario(LATER)
    folder = dead(tmp_path / "dead", flown, 130)
    for dies_at in (240, 330):
        going_on = back(folder)
        again = RunFolder(folder.parent, "run", flown, going_on.past)
        engine = Engine(flown, "run", sinks=[again], resume=going_on.start)
        for tick in engine.fly():
            if tick == dies_at:
                break
        again._background.wait()
        again._spool = None  # type: ignore[assignment]
        again._events.close()
    assert back(folder).start.tick == 301
    assert steady(resumed(folder)) == steady(undisturbed)
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(351))
    assert [e["tick"] for e in events(folder) if e["kind"] == "resumed"] == [101, 201, 301]


def test_a_spool_cut_off_in_the_middle_of_a_block_is_resumed_all_the_same(undisturbed, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("meanflock.groundstation.launch.engine._BLOCK_ROWS", 20)  # some since the checkpoint
    flown = scenario(LATER)
    folder = dead(tmp_path / "dead", flown, 250)
    spool = folder / ".telemetry"
    os.truncate(spool, spool.stat().st_size - 1000)
    with (folder / "events.jsonl").open("a") as file:
        file.write('{"tick": 2')
    assert resumed(folder)["trajectory_sha256"] == undisturbed["trajectory_sha256"]
    assert all(event["tick"] <= 350 for event in events(folder))


def test_an_interrupted_run_that_has_its_summary_goes_on_too(undisturbed: dict[str, Any], tmp_path: Path) -> None:
    flown = scenario(LATER)
    folder = RunFolder(tmp_path / "dead", "run", flown)
    engine = Engine(flown, "run", sinks=[folder])
    for tick in engine.fly():
        if tick == 250:
            break
    with folder:
        folder.summarise(engine.world.finish())
    assert (folder.path / "timeseries.parquet").exists()
    assert steady(resumed(folder.path)) == steady(undisturbed)
    assert [event["kind"] for event in events(folder.path)].count("finished") == 1


def test_while_some_are_paused_no_checkpoint_is_taken_that_would_lack_their_minds() -> None:
    lab = Lab(scenario('faults=[{kind="pause", tick=95, duration_s=1.0, uavs=[1]}]'))
    lab.fly()
    assert [block.first_tick for block in lab.record.blocks if block.checkpoint] == [0]


def test_a_run_whose_uavs_were_all_lost_is_resumed(tmp_path: Path) -> None:
    lost = scenario("faults=[{kind='kill',tick=30,uavs=[0,1,2,3,4,5]}]", LATER, "method=windmap")
    whole = flight(tmp_path / "whole", lost)
    assert steady(resumed(dead(tmp_path / "dies", lost, 150))) == steady(whole)
