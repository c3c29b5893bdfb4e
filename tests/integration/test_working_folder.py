"""Commands import nothing from the working folder, whatever its files are called."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.hostile_folder import hostile
from tests.polling import DEADLINE_S

pytestmark = pytest.mark.processes


@pytest.mark.parametrize(
    "flags",
    [
        ("run", "--uavs", "2", "--uavs-per-process", "2", "--duration", "3", "--json", "--quiet", "--no-record"),
        ("sweep", "uavs=2,3", "--seeds", "2", "--duration", "3", "--jobs", "2", "--quiet"),
    ],
    ids=["run", "sweep"],
)
def test_a_command_imports_nothing_from_the_working_folder(flags: tuple[str, ...], tmp_path: Path) -> None:
    working, ran = hostile(tmp_path)
    out = tmp_path / "out"
    as_the_script_does = ["-P", "-c", "from meanflock.groundstation.cli.command import main; main()"]
    command = [sys.executable, *as_the_script_does, *flags, "--out", str(out)]
    done = subprocess.run(command, cwd=working, capture_output=True, text=True, timeout=DEADLINE_S)
    assert not ran.exists(), ran.read_text()
    assert done.returncode == 0, done.stderr
    assert out.exists()
    if "--json" in flags:
        assert json.loads(done.stdout)["ticks"] == 30
    else:
        assert done.stderr == ""  # its workers ended silently
