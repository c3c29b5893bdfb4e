"""`meanflock new`: packages that install, conform and fly as they are, and names that cannot be used."""

import json
import os
import sys
from pathlib import Path
from typing import get_args

import pytest

from meanflock.groundstation import scaffold
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.commands import printed


@pytest.fixture(scope="module")
def backend(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the build backend, so that packages are built without an environment each."""
    folder = tmp_path_factory.mktemp("backend")
    printed(sys.executable, "-m", "pip", "install", "-q", "--target", folder, "setuptools>=77", cwd=folder)
    return folder


@pytest.mark.processes
@pytest.mark.xdist_group("packaging")
@pytest.mark.parametrize("kind", get_args(scaffold.Kind))
def test_a_new_package_installs_conforms_and_flies(kind: scaffold.Kind, run, tmp_path, backend, monkeypatch) -> None:
    code, out, _ = run("new", kind, "swirl_2")
    assert (code, "Next: pip install -e ./swirl_2" in out) == (EXIT_DONE, True)
    assert [line for line in out.splitlines() if line.startswith("swirl_2/") and not (tmp_path / line).is_file()] == []
    site = tmp_path / "site"
    install = ("-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target", site, "./swirl_2")
    printed(sys.executable, *install, env=os.environ | {"PYTHONPATH": str(backend)})
    monkeypatch.setenv("PYTHONPATH", str(site))
    assert "2 passed" in printed(sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "swirl_2")
    command, *flight = scaffold.flight(kind, "swirl_2").split()
    short = ("--json", "--quiet", "--no-record", "--uavs", "4", "--duration", "25")
    summary = json.loads(printed(Path(sys.executable).with_name(command), *flight, *short))
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
