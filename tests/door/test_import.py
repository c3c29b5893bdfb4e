"""`import meanflock` loads nothing, changes nothing, and imports nothing from the working folder."""

import json
import sys
from pathlib import Path

import meanflock as mf
from tests.commands import printed

LOOK = """
import json, os, signal, sys
before = dict(os.environ), signal.getsignal(signal.SIGINT), set(sys.modules)
import meanflock
assert dict(os.environ) == before[0]
assert signal.getsignal(signal.SIGINT) is before[1]
loaded = set(sys.modules) - before[2]
names = dir(meanflock)
assert set(sys.modules) - before[2] == loaded
print(json.dumps([sorted(name.split(".")[0] for name in loaded), names]))
"""
FLY = """
import os
before = dict(os.environ)
import meanflock as mf
run = mf.fly("paper", method="mfgfl-h", uavs=3, seed=3, duration=12, **{"federation.period": 20})
assert dict(os.environ) == before
print(run.summary["trajectory_sha256"])
"""
HOSTILE = "raise SystemExit('a file of somebody else was taken for ours')\n"


def python(code: str, folder: Path) -> str:
    """What code prints that is run in a folder, which is first on the path."""
    return printed(sys.executable, "-c", code, cwd=folder)


def test_importing_loads_nothing_and_changes_nothing(tmp_path: Path) -> None:
    loaded, names = json.loads(python(LOOK, tmp_path))
    assert not set(loaded) & {"numpy", "msgspec", "msgpack", "zenoh", "pyarrow", "rerun", "click"}
    assert [name for name in loaded if name == "meanflock"] == ["meanflock"]
    assert [name for name in names if not name.startswith("__")] == sorted(mf.__all__)
    assert all(getattr(mf, name) is not None for name in names)
    assert not hasattr(mf, "flie")


def test_a_comparison_loads_no_plots_and_draws_nothing_from_the_random_numbers_of_others(tmp_path: Path) -> None:
    code = "import random, sys; random.seed(1); before = random.getstate(); import meanflock as mf; mf.compare\n"
    code += "assert random.getstate() == before; print(*({'matplotlib', 'rich', 'rerun', 'click'} & set(sys.modules)))"
    assert python(code, tmp_path).split() == []


def test_a_hostile_working_folder_harms_nothing(tmp_path: Path) -> None:
    for name in ("agent.py", "leader.py", "channel.py", "worldsim.py", "kernels.py", "groundstation.py", "state.py"):
        (tmp_path / name).write_text(HOSTILE)
    for name in ("swarm", "testing"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(HOSTILE)
    clean = tmp_path / "clean"
    clean.mkdir()
    assert python(FLY, tmp_path) == python(FLY, clean) != ""
