"""The wheel, as somebody installs it who has no checkout: one import name, and a plug-in flies wherever it is run."""

import json
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests.integration.hostile_folder import LIBRARIES, PACKAGES, hostile
from tests.polling import DEADLINE_S

pytestmark = [pytest.mark.processes, pytest.mark.xdist_group("wheel")]

ROOT = Path(__file__).parents[2]


def done(*line: str | Path, cwd: Path) -> str:
    """Standard output of a command that must end well."""
    ended = subprocess.run(list(map(str, line)), cwd=cwd, capture_output=True, text=True, timeout=DEADLINE_S)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, as the images build it: what an earlier build left in the checkout does not enter."""
    folder, source = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("source")
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, source)
    for room in PACKAGES:
        shutil.copytree(ROOT / room, source / room, symlinks=True, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    line = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--wheel-dir", str(folder), str(source)]
    built = subprocess.run(line, cwd=folder, capture_output=True, text=True, timeout=DEADLINE_S)
    if "No module named pip" in built.stderr or "No matching distribution found for setuptools" in built.stderr:
        pytest.skip(built.stderr.strip().splitlines()[-1])
    assert built.returncode == 0, built.stderr
    (file,) = folder.iterdir()
    return file


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment with the wheel, and links to the libraries that are installed here."""
    environment = tmp_path_factory.mktemp("environment")
    done(sys.executable, "-m", "venv", "--without-pip", environment, cwd=environment)
    python = environment / "bin" / "python"
    done(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", wheel, cwd=environment)
    (packages,) = environment.glob("lib/python*/site-packages")
    for path in {Path(sysconfig.get_path(name)) for name in ("purelib", "platlib")}:
        for library in path.iterdir():
            if "meanflock" not in library.name and library.suffix != ".pth" and library.name != "__pycache__":
                (packages / library.name).symlink_to(library)
    return python


def test_all_of_the_wheel_is_below_one_name(wheel: Path) -> None:
    names = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {name for name in names if not name.endswith(".dist-info")} == {"meanflock"}
    assert len(names) == 2


TYPED = """
import meanflock as mf

class Still(mf.Controller):
    name = "still"

run = mf.fly(method=Still, uavs=2, duration=1)
reveal_type(run.states)
"""


def test_a_type_checker_sees_the_types_of_the_wheel(python: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(TYPED)
    line = [sys.executable, "-m", "mypy", "--strict", "--python-executable", python, tmp_path / "mine.py"]
    assert 'numpy.dtype[numpy.float64]]"' in done(*line, cwd=tmp_path)


def test_nothing_of_ours_but_meanflock_can_be_imported(python: Path, tmp_path: Path) -> None:
    find = "import sys; from importlib.util import find_spec; print(*(n for n in sys.argv[1:] if find_spec(n)))"
    assert done(python, "-c", find, *PACKAGES, cwd=tmp_path).split() == ["meanflock"]
    where = Path(done(python, "-c", "import meanflock; print(meanflock.__file__)", cwd=tmp_path).strip())
    assert where.is_relative_to(python.parents[1])


def test_a_plug_in_flies_from_a_hostile_working_folder_in_processes_as_in_one(python: Path, tmp_path: Path) -> None:
    working, ran = hostile(tmp_path)
    flags = ["--plugin", ROOT / "examples" / "spring.py", "--method", "spring", "--uavs", "3", "--duration", "10"]
    line = [python.with_name("meanflock"), "run", *flags, "--no-record", "--json", "--quiet", "--out", tmp_path / "out"]
    each, alone = (json.loads(done(*line, *mode, cwd=working)) for mode in ((), ("--in-process",)))
    assert not ran.exists(), ran.read_text()
    assert (each["mode"], alone["mode"]) == ("processes", "in-process")
    assert each["trajectory_sha256"] == alone["trajectory_sha256"]
    assert (each["method"], each["ticks"], each["lost"]) == ("spring", 100, 0)
    assert sorted(path.name for path in working.iterdir()) == sorted(
        [*PACKAGES, *(f"{name}.py" for name in (*PACKAGES, *LIBRARIES))]
    )
