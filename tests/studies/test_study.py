"""Comparisons and sweeps: their flights, wrong arguments, interruption and repetition."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

import meanflock as mf
from meanflock.groundstation.cli.command import main
from meanflock.studies import study
from meanflock.studies.swept import Swept
from meanflock.swarm.errors import EXIT_DONE, EXIT_RUN_FAILED, BadInput
from meanflock.swarm.scenario import load
from meanflock.swarm.toml import apply
from tests.polling import DEADLINE_S, until
from tests.studies.conftest import QUICK, flown, rows

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.mark.parametrize(
    ("swept", "flags", "wanted"),
    [
        (
            "method=hjb,mfg",
            ("--seeds", "2", "--uavs", "2"),
            [("hjb", 2, 1), ("hjb", 2, 2), ("mfg", 2, 1), ("mfg", 2, 2)],
        ),
        ("seed=5,9", ("--scenario", "mine.toml"), [("mfg", 2, 5), ("mfg", 2, 9)]),
        ("uavs=2,3", ("--methods", "mfg", "--seeds", "1"), [("mfg", 2, 1), ("mfg", 3, 1)]),
    ],
)
def test_method_seed_and_uavs_are_swept_like_any_key(run, tmp_path, swept, flags, wanted) -> None:
    (tmp_path / "mine.toml").write_text('method = "mfg"\nuavs = 2\n')
    code, out, err = run("sweep", swept, *flags, *QUICK)
    assert (code, err) == (EXIT_DONE, "")
    assert [(one["method"], one["uavs"], one["seed"]) for one in flown(tmp_path / "out")] == wanted
    column = swept.partition("=")[0]
    assert column in out
    (label,) = [name for name in rows(tmp_path / "out/sweep.csv")[0] if name.startswith(column)][:1]
    assert [row[label] for row in rows(tmp_path / "out/sweep.csv")] == swept.partition("=")[2].split(",")


def test_values_are_words_numbers_lists_or_tables() -> None:
    assert Swept.parse("radio.fading=amplitude, power").values == ("amplitude", "power")
    assert Swept.parse("federation.period=50,100").values == (50, 100)
    lists = Swept.parse("wind.mean=[1, -1],[0.5, 0.5]")
    assert [load(None, [lists.setting(value)]).wind.mean for value in lists.values] == [(1.0, -1.0), (0.5, 0.5)]
    discs = Swept.parse("obstacles=[], [{centre = [30.0, 0.0], radius = 2.0}]")
    assert [len(load(None, [discs.setting(value)]).obstacles) for value in discs.values] == [0, 1]
    words = Swept.parse("""x=["a, b", "it's", "\\n"], [true]""")
    apply(table := {}, words.setting(words.values[0]))
    assert table == {"x": ["a, b", "it's", "\n"]}
    with pytest.raises(BadInput, match="KEY=VALUE"):
        Swept.parse("wind.sigma")


HELD = """
import time
from pathlib import Path
import meanflock as mf

class Held(mf.Controller):
    name = "held"

    def step(self, memory, tick, own, received):
        while self.scenario.seed > 1 and Path({!r}).exists():
            time.sleep(0.01)
        return mf.Step(memory, 0.0 * own[:, :2])
"""


@pytest.mark.processes
def test_ctrl_c_ends_a_sweep_and_its_workers_and_a_repeat_goes_on(tmp_path: Path) -> None:
    """Flights of the first seed end; all others wait for as long as a file is there, so none is over by chance."""
    (hold := tmp_path / "hold").touch()
    (plugin := tmp_path / "held.py").write_text(HELD.format(str(hold)), encoding="utf-8")
    out = tmp_path / "out"
    command = [sys.executable, "-c", "from meanflock.groundstation.cli.command import main; main()", "sweep"]
    command += ["wind.sigma=0.1,0.2,0.3", "--methods", "held", "--plugin", str(plugin), "--uavs", "2"]
    command += ["--duration", "2", "--seeds", "3", "--jobs", "2", "--quiet", "--out", str(out)]
    pipe = subprocess.PIPE
    flying = subprocess.Popen(command, stderr=pipe, stdout=pipe, start_new_session=True)
    until(lambda: list(out.glob("data/jobs/*.job")) or flying.poll() is not None, "a finished flight")
    family = psutil.Process(flying.pid).children(recursive=True)
    os.killpg(flying.pid, signal.SIGINT)
    printed, said = flying.communicate(timeout=DEADLINE_S)
    assert not psutil.wait_procs(family, timeout=DEADLINE_S)[1]
    assert (flying.returncode, printed) == (EXIT_RUN_FAILED, b"")
    assert b"error: interrupted; " in said
    assert b" of 9 runs are kept in" in said
    assert b"Traceback" not in said
    kept = {path: path.stat().st_mtime_ns for path in out.glob("data/jobs/*.job")}
    assert 0 < len(kept) < 9
    hold.unlink()
    assert main([*command[3:], "--jobs", "1"]) == EXIT_DONE
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert len(flown(out)) == 9
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "_fly", lambda *_, **__: pytest.fail("flown again"))
        assert main([*command[3:], "--jobs", "1"]) == EXIT_DONE


MINE = """
import meanflock as mf

class Mine(mf.Controller):
    name = "{}"

    def step(self, memory, tick, own, received):
        return mf.Step(memory, own[:, :2] * {})
"""


def test_a_changed_plugin_flies_again(tmp_path: Path) -> None:
    """The folder `out` has the flights of an earlier form of the file."""

    def energy(name: str, push: float) -> list[float]:
        (tmp_path / f"{name}.py").write_text(MINE.format(name, push), encoding="utf-8")
        out = tmp_path / "out"
        return [
            row["energy_mean_J"]
            for row in mf.compare(
                [name], plugin=tmp_path / f"{name}.py", seeds=2, jobs=1, out=out, uavs=2, duration=2.0
            )
        ]

    first = energy("one", -0.01)
    assert energy("other", -0.02) != first
    assert energy("one", -0.02) == energy("other", -0.02) != first
