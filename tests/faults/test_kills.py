"""kill -9 at random ticks of whoever takes part, the world too, with and without TLS: nobody hangs, nothing is lost."""

import json
import random
import signal
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from meanflock.groundstation import certs
from meanflock.groundstation.cli.command import main
from meanflock.swarm import scenario as scenarios
from tests.faults.conftest import SETTINGS, Flight, Lab, Processes, ends_by_itself
from tests.polling import DEADLINE_S

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]

FLOWN = (*SETTINGS, "duration=400")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kills") / "certs"
    certs.init(folder, 3)
    return folder


@pytest.fixture(scope="module")
def undisturbed() -> str:
    """The trajectory of `FLOWN` if nobody dies."""
    return str(Lab(scenarios.load(None, FLOWN)).fly()["trajectory_sha256"])


def test_under_tls_killed_agents_rejoin_with_the_certificates_they_had(
    processes: Processes, certificates: Path, tmp_path: Path
) -> None:
    draw = random.Random(1)
    processes.base += ("--tls", str(certificates))
    flight = Flight(processes, tmp_path, barrier_s=60.0)
    tick = 0
    for number in range(1, 4):
        victim = draw.randrange(3)
        flight.reach(tick := tick + draw.randrange(20, 120))
        flight.agents[victim].kill()
        flight.agents[victim] = processes.start("agent", "--uav", str(victim))
        rejoined = flight.event("rejoined", number)
        assert rejoined["uavs"] == [victim]
        tick = rejoined["tick"]
    summary = flight.end()
    assert (summary["lost"], summary["nodes_lost"]) == (0, 3)
    assert summary["dropped_messages"].keys() <= {"unknown-node"}  # last words of the dead: nobody was refused
    for process in (*flight.agents, *flight.leaders, flight.station):
        ends_by_itself(process)


@pytest.mark.parametrize(("seed", "tls"), [(2, False), (3, True)])
def test_a_run_whose_leader_station_and_world_are_killed_at_random_ticks_is_resumed_to_the_same_end(
    seed: int, tls: bool, processes: Processes, certificates: Path, tmp_path: Path, undisturbed: str
) -> None:
    secure = ("--tls", str(certificates)) if tls else ()
    processes.base += secure
    flight = Flight(processes, tmp_path, leaders=2, settings=FLOWN)
    first, second, third = sorted(random.Random(seed).sample(range(1, 700), 3))
    flight.reach(first)
    flight.leaders.pop().kill()
    flight.leaders.append(processes.start("leader", "--wait", "5"))
    assert "stands by" in flight.event("rejoined")["text"]
    flight.reach(second)
    flight.station_again(signal.SIGKILL)
    flight.reach(max(third, 150))  # there is a checkpoint
    flight.world.kill()
    for process in (flight.leaders[-1], flight.station):
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 1, err
        assert err.splitlines()[-1].startswith("error: the world ")
        assert " is gone" in err
        assert "meanflock resume" in err
    for process in (*flight.agents, *flight.leaders[:-1]):
        process.terminate()  # they would wait for a world to come back
    (folder,) = tmp_path.iterdir()
    how = secure or ("--in-process",)  # processes without TLS: test_resume_processes.py
    assert main(["resume", str(folder), *how, "--json", "--quiet", "--no-record"]) == 0
    assert json.loads((folder / "summary.json").read_text())["trajectory_sha256"] == undisturbed
    assert pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist() == list(range(4001))
