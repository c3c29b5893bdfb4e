"""Real processes in real time with a wall clock that jumps."""

import json
from pathlib import Path

import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.scenario import load
from tests.integration.conftest import SETTINGS, SHORT, Command, Spawn
from tests.polling import DEADLINE_S

pytestmark = pytest.mark.processes


# Each look at the wall clock finds it hours away from the last one.
ASTRAY = """
import itertools, time
_hours, _time, _time_ns = itertools.cycle((0, 5, -30, 1, -2, 100, -9)), time.time, time.time_ns
time.time = lambda: _time() + 3600 * next(_hours)
time.time_ns = lambda: _time_ns() + 3600 * 10**9 * next(_hours)
"""


def test_a_wall_clock_that_jumps_by_hours_changes_nothing(
    command: Command, spawn: Spawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calm = Engine(load(None, SETTINGS), "calm").complete()
    (tmp_path / "sitecustomize.py").write_text(ASTRAY)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    astray = command.start("--json", "--log-format", "json", *SHORT)
    out, err = astray.communicate(timeout=DEADLINE_S)
    assert astray.returncode == 0, err
    lines = [json.loads(line) for line in err.splitlines()]
    # Four nodes joined within seconds, at hours all over the week: the clock did jump.
    assert len(lines) == sum("joined" in line["message"] for line in lines) == 4
    assert len({line["time"][:13] for line in lines}) >= 3
    summary = json.loads(out)
    timing = ("wall_time_s", "real_time_factor", "mode", "run_id", "wire_bytes", "radio")
    assert {k: v for k, v in summary.items() if k not in timing} == {k: v for k, v in calm.items() if k not in timing}
    assert 0.0 < summary["wall_time_s"] < DEADLINE_S
    paced = Command(tmp_path / "paced", spawn).summary_of_a_process(*SHORT, "--realtime=15")
    assert 2.0 <= paced["wall_time_s"] < DEADLINE_S  # 30 s, 15 times faster; a busy machine may be late
    assert paced["real_time_factor"] == pytest.approx(30.0 / paced["wall_time_s"])
    kept, jitter = paced["realtime"], paced["realtime"]["tick_start_jitter_ms"]
    assert (kept["factor"], paced["lost"]) == (15.0, 0)
    assert 0 <= kept["deadline_misses"] <= min(300, paced["held_commands"])
    assert 0.0 <= jitter["mean"] <= jitter["max"] < 1e3 * DEADLINE_S
    assert 0.0 < jitter["p99"] <= jitter["max"]
