"""MAVSDK, the client library of autopilots, finds the vehicles of a flight, reads their states and steers one."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import meanflock as mf
from meanflock.net.access import Address
from tests.commands import COMMAND, printed

SCRIPT = Path(__file__).with_name("mavsdk_steers.py")
JUDGE = "mavsdk"
UAVS = 5
STEERED = 2
STRONG = 4.0  # m/s², to the north
END_S = 120.0


@contextmanager
def running(*line: object) -> Iterator["subprocess.Popen[str]"]:
    """A command of meanflock, which ends by itself."""
    with subprocess.Popen([*COMMAND, *map(str, line)], stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
            _, said = process.communicate(timeout=END_S)
            assert process.returncode == 0, said
        finally:
            process.kill()


def judged(python: Path, url: str, steered: int) -> dict[str, Any]:
    return json.loads(printed(python, SCRIPT, url, UAVS, steered).splitlines()[-1])


def check(said: dict[str, Any], run: mf.Run) -> None:
    """Every sample is, as float32, the state of the tick of its time stamp."""
    assert said["systems"] == list(range(1, UAVS + 1))
    flown = run.states.astype(np.float32)[..., [1, 0, 3, 2]]  # north before east
    for uav in range(UAVS):
        messages = said["messages"][str(uav + 1)]
        assert len(messages) > 10
        ticks = [round(message["time_boot_ms"] / 1e3 / run.scenario.dt) for message in messages]
        assert [message["time_boot_ms"] for message in messages] == [round(1e3 * k * run.scenario.dt) for k in ticks]
        read = np.array([[message[name] for name in ("x", "y", "vx", "vy")] for message in messages], dtype=np.float32)
        assert read.tobytes() == flown[ticks, uav].tobytes()
        known = {row.tobytes() for row in flown[:, uav]}
        states = np.array(said["states"][str(uav + 1)], dtype=np.float32)
        assert len(states) > 10
        assert all(row.tobytes() in known for row in states)


def test_mavsdk_steers_one_uav_of_a_flight(python: Path, tmp_path: Path) -> None:
    port = Address("127.0.0.1", 0).free("--steer", datagrams=True).port
    line = ["run", "--realtime", "--steer", port, "--uavs", UAVS, "--duration", 30, "--seed", 7, "--quiet"]
    with running(*line, "--no-record", "--out", tmp_path):
        said = judged(python, f"udpout://127.0.0.1:{port}", STEERED + 1)
    (folder,) = tmp_path.iterdir()
    run = mf.open(folder)
    check(said, run)
    events = [(event["kind"], event["uavs"]) for event in run.events if event["kind"] in ("steered", "released")]
    assert events == [("steered", [STEERED]), ("released", [STEERED])]
    rows = run.frame()
    north = np.array(rows["ay_m_s2"].to_pylist())
    pushed = (north == STRONG) & (np.array(rows["ax_m_s2"].to_pylist()) == 0.0)
    steered = pushed.sum(axis=0)
    assert steered[STEERED] == run.summary["steered"]["uav_ticks"] > 10
    assert np.delete(steered, STEERED).tolist() == [0] * (UAVS - 1)


def test_mavsdk_sees_a_run_that_is_played(python: Path, tmp_path: Path) -> None:
    run = mf.fly("paper", uavs=UAVS, duration=30, seed=7, out=tmp_path / "runs")
    port = Address("127.0.0.1", 0).free("--to", datagrams=True).port
    with running("bridge", "mavlink", run.folder, "--to", port):
        check(judged(python, f"udpin://127.0.0.1:{port}", 0), run)
