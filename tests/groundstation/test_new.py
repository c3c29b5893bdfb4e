"""`meanflock new`: packages that install, conform and fly as they are, and names that cannot be used."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from meanflock.groundstation import scaffold
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.polling import DEADLINE_S


@pytest.fixture(scope="module")
def backend(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the build backend, so that packages are built without an environment each."""
    folder = tmp_path_factory.mktemp("backend")
    call([sys.executable, "-m", "pip", "install", "-q", "--target", folder, "setuptools>=77"], folder, folder)
    return folder


def call(line: list[str | Path], cwd: Path, path: Path) -> str:
    """Standard output of a command that must end well, with `path` as PYTHONPATH."""
    env = os.environ | {"PYTHONPATH": str(path), "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    ended = subprocess.run(list(map(str, line)), cwd=cwd, env=env, capture_output=True, text=True, timeout=DEADLINE_S)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.processes
@pytest.mark.xdist_group("packaging")
@pytest.mark.parametrize("kind", get_args(scaffold.Kind))
def test_a_new_package_installs_conforms_and_flies(kind: scaffold.Kind, run, tmp_path: Path, backend: Path) -> None:
    code, out, _ = run("new", kind, "swirl_2")
    assert (code, "Next: pip install -e ./swirl_2" in out) == (EXIT_DONE, True)
    assert [line for line in out.splitlines() if line.startswith("swirl_2/") and not (tmp_path / line).is_file()] == []
    site = tmp_path / "site"
    install = ["-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target", site, "./swirl_2"]
    call([sys.executable, *install], tmp_path, backend)
    assert "2 passed" in call(
        [sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "swirl_2"], tmp_path, site
    )
    flight = scaffold.flight(kind, "swirl_2").split()
    line = [Path(sys.executable).parent / flight[0], *flight[1:], "--json", "--quiet", "--no-record"]
    summary = json.loads(call([*line, "--uavs", "4", "--duration", "25"], tmp_path, site))
    assert (summary["uavs"], summary["lost"], summary["collisions_all"] >= 0) == (4, 0, True)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("hjb", "a controller of that name is installed, of meanflock"),
        ("class", "a keyword of Python"),
        ("none", "or its class would be"),
        ("1st", "letters, digits and underscores"),
        ("a-b", "letters, digits and underscores"),
        ("../x", "letters, digits and underscores"),
        ("json", "Python has a module of that name"),
        ("here", "exists already"),
        ("link", "exists already"),
    ],
)
def test_a_name_that_cannot_be_used_is_refused_and_nothing_is_written(name: str, says: str, run, tmp_path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "link").symlink_to("nowhere")
    code, out, err = run("new", "controller", name)
    assert (code, out, err.count("\n"), says in err) == (EXIT_BAD_INPUT, "", 1, True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["here", "link"]
