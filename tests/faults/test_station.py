"""Ground stations: telemetry that none has acknowledged is kept up to a bound, and one goes on in its folder."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.groundstation.__main__ import LATEST, _folder
from meanflock.launch.station import RecordingStation
from meanflock.net import keys, outbox
from meanflock.net.bus import Delivery
from meanflock.results.run_folder import SUMMARY
from meanflock.swarm.errors import BadInput
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Join, Welcome
from tests.faults.conftest import RUN, Lab, scenario
from tests.faults.dying import dead
from tests.telemetry import Record

OF_RUN = "compose"
LONG = scenario("duration=35")


def listen(lab: Lab, **options: Any) -> Record:
    record, bus = Record(), lab.engine.network.endpoint()
    bus.handler = RecordingStation(bus, RUN, [record], **options).handle
    return record


def deafen(lab: Lab) -> None:
    """The station hears nothing more, and the world does not notice it."""
    lab.engine.network.endpoints.remove(lab.engine.network.endpoints[1])


def test_a_station_that_comes_late_is_sent_every_row_and_the_latest_checkpoint() -> None:
    lab, late = Lab(scenario("duration=60")), list[Record]()
    deafen(lab)
    lab.fly({560: lambda: late.append(listen(lab))})
    ticks = np.concatenate([b.first_tick + np.arange(len(b.states)) for b in late[0].blocks])
    assert ticks.tolist() == list(range(601))
    assert next(event.kind for event in late[0].events) == "joined"
    assert sum(bool(block.checkpoint) for block in late[0].blocks) == 1


def test_a_station_that_starts_after_the_last_tick_is_let_in_and_sent_what_waits() -> None:
    lab = Lab(scenario(), stations=1)
    lab.engine.network.endpoints[1].close()
    late: list[Record] = []

    def start(_timeout_s: float) -> None:
        if not late:
            raw = control.encode(Join("station", 0))
            answer = lab.engine.network.endpoint().ask(keys.join(RUN, keys.requested_name("station")), raw, 1.0)
            assert isinstance(control.decode(answer), Welcome)
            late.append(listen(lab))

    lab.engine.hub.receive = start
    lab.fly()
    assert sum(len(block.states) for block in late[0].blocks) == 121


def test_beyond_its_bound_the_world_gives_up_the_oldest_blocks_and_counts_them(monkeypatch, caplog) -> None:
    monkeypatch.setattr(outbox, "MAX_WAITING_BYTES", 70_000)
    lab = Lab(scenario("duration=40"))
    deafen(lab)
    assert max(lab.engine.outbox._bytes for _ in lab.engine.fly()) <= 70_000
    record = listen(lab, first_block=0)
    summary = lab.engine.finish()
    assert summary["telemetry_blocks_dropped"] > 0
    first = record.blocks[0]
    assert first.block >= summary["telemetry_blocks_dropped"]
    assert f"{first.block} blocks of telemetry before tick {first.first_tick} will never come" in caplog.text
    assert summary["trajectory_sha256"] == Lab(scenario("duration=40")).fly()["trajectory_sha256"]


@pytest.mark.parametrize("lost", [[2, 3, 4], [1, 6]])
def test_blocks_that_are_lost_with_a_session_come_again(lost: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("meanflock.launch.engine._BLOCK_ROWS", 10)
    lab, whole = Lab(scenario()), Lab(scenario())
    bus, station, left = lab.engine.network.endpoints[1], lab.engine.station, lost.copy()

    def lossy(delivery: Delivery) -> None:
        if delivery.kind == "message" and control.decode(delivery.payload).block in left:
            left.remove(control.decode(delivery.payload).block)
        else:
            station.handle(delivery)

    bus.handler = lossy
    assert lab.fly()["trajectory_sha256"] == whole.fly()["trajectory_sha256"]
    assert not left
    assert [block.block for block in lab.record.blocks] == [block.block for block in whole.record.blocks]
    assert station.summary is not None


@pytest.mark.parametrize(
    ("every_s", "linger_s", "all_of_it"), [(8.0, 10.0, True), (12.0, 10.0, False), (12.0, math.inf, True)]
)
def test_the_world_waits_for_a_slow_station_that_takes_something_now_and_then(
    every_s: float, linger_s: float, all_of_it: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("meanflock.launch.engine._BLOCK_ROWS", 40)
    lab = Lab(scenario())
    lab.engine.network.endpoints[1].close()
    now = [0.0]
    bus, slow = lab.engine.network.endpoint(), Record()
    station, waiting = RecordingStation(bus, RUN, [slow]), []
    bus.handler = waiting.append

    def wait(timeout_s: float) -> None:
        now[0] += timeout_s
        if waiting and now[0] % every_s < timeout_s:
            station.handle(waiting.pop(0))

    lab.engine.hub.receive, lab.now = wait, lambda: now[0]
    for _ in lab.engine.fly():
        pass
    summary = lab.engine.finish(lambda: linger_s)
    assert (station.summary == summary) is all_of_it
    assert (sum(len(block.states) for block in slow.blocks) == 121) is all_of_it


def test_a_station_goes_on_in_no_folder_that_is_finished_or_of_another_scenario_or_empty(tmp_path: Path) -> None:
    finished = dead(tmp_path, LONG, 250).rename(tmp_path / "compose-20260101-000000")
    found = _folder(LATEST, tmp_path, OF_RUN, LONG, 260)
    assert found is not None
    assert found[0] == finished
    assert _folder(LATEST, tmp_path, OF_RUN, LONG, 50) is None  # of a flight that has not come so far
    (finished / SUMMARY).write_text("{}")
    assert _folder(LATEST, tmp_path, OF_RUN, LONG, 260) is None
    dead(tmp_path, scenario("duration=35", "seed=4"), 250).rename(tmp_path / "compose-20260102-000000")
    assert _folder(LATEST, tmp_path, OF_RUN, LONG, 260) is None
    (tmp_path / "compose-20260103-000000").mkdir()
    assert _folder(LATEST, tmp_path, OF_RUN, LONG, 260) is None
    with pytest.raises(BadInput, match="not a run of the scenario"):
        _folder(str(tmp_path / "compose-20260102-000000"), tmp_path, OF_RUN, LONG, 260)
