"""Source distribution and wheel, installed in fresh environments and flown."""

import json
import os
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import meanflock as mf
from meanflock.swarm.errors import EXIT_BAD_INPUT
from tests.commands import ended, printed
from tests.pages import modules_of
from tests.sources import BESIDE, EXTRAS, PROJECT, ROOMS, ROOT, direct
from tests.wheels.conftest import made_environment

pytestmark = pytest.mark.processes

SPRING = ROOT / "examples" / "spring.py"
PAGES = [
    ROOT / "README.md",
    *(ROOT / "docs" / f"{name}.md" for name in ("first-flight", "your-controller", "your-aggregation")),
]
PACKAGES = (*ROOMS, "meanflock", "research")
LIBRARIES = ("concurrent", "msgspec", "numpy", "zenoh")


def hostile(below: Path) -> tuple[Path, Path]:
    """A working folder with files and folders of all our names, and where each leaves a trace if it is run."""
    working, ran = below / "working", below / "ran"
    trace = f"open({str(ran)!r}, 'a').write(__name__ + '\\n')\nraise SystemExit('not ours')\n"
    for name in PACKAGES:
        (working / name).mkdir(parents=True)
        for file in ("__init__.py", "__main__.py"):
            (working / name / file).write_text(trace)
    for name in (*PACKAGES, *LIBRARIES):
        (working / f"{name}.py").write_text(trace)
    return working, ran


def oldest(requirement: Requirement) -> str:
    (first,) = (bound.version for bound in requirement.specifier if bound.operator == ">=")
    return f"{requirement.name}=={first}"


@pytest.fixture(scope="module", params=["newest", "oldest"])
def python(request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of a fresh environment with the newest or the oldest libraries of all ranges. Rerun is not among
    the oldest: it needs newer NumPy."""
    environment = tmp_path_factory.mktemp(request.param)
    if request.param == "newest":
        wanted = [f"{wheel}[ground]"]
    elif sys.version_info >= (3, 13):
        pytest.skip("the oldest NumPy has no wheel for this Python")
    else:
        libraries = direct(PROJECT["dependencies"], EXTRAS["world"], EXTRAS["fly"], EXTRAS["ground"])
        wanted = [str(wheel), *(oldest(library) for library in libraries if library.name != "rerun-sdk")]
    return made_environment(Path(sys.executable), environment, *wanted)


def test_both_distributions_have_what_the_checkout_has(built: Path, wheel: Path) -> None:
    """Whatever can be imported or read below meanflock/ in a checkout is in the wheel, and nothing else is."""
    (source,) = built.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        parts = {tuple(name.split("/")[1:]) for name in archive.getnames()}
    assert {part[0] for part in parts if part[1:] == ("__init__.py",)} == {"meanflock", *BESIDE}
    assert not {part[1] for part in parts if part[:1] == ("meanflock",) and part[1:]} & set(BESIDE), (
        "links are followed"
    )
    packed = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    present = {
        (Path(folder) / file).relative_to(ROOT).as_posix()
        for folder, _, files in os.walk(ROOT / "meanflock", followlinks=True)
        for file in files
        if not file.endswith((".c", ".h", ".so", ".pyc"))
    }
    assert {name for name in packed if not name.endswith(".so")} == present


def test_it_flies_from_a_hostile_working_folder_as_the_checkout_does(python: Path, tmp_path: Path) -> None:
    """A plug-in on processes with TLS and in one, a method that learns and federates, and a study with workers."""
    find = "import sys; from importlib.util import find_spec; print(*(n for n in sys.argv[1:] if find_spec(n)))"
    assert printed(python, "-c", find, *PACKAGES, cwd=tmp_path).split() == ["meanflock"]
    working, ran = hostile(tmp_path)
    meanflock = python.with_name("meanflock")
    printed(meanflock, "certs", "init", tmp_path / "certs", "--uavs", "3", cwd=working)
    command = [meanflock, "run", "--no-record", "--json", "--quiet", "--out", tmp_path / "out"]
    plug_in = ["--plugin", SPRING, "--method", "spring", "--uavs", "3", "--duration", "10"]
    each, alone, federated = (
        json.loads(printed(*command, *flags, cwd=working))
        for flags in (
            [*plug_in, "--tls", tmp_path / "certs", "--uavs-per-process", "2"],
            [*plug_in, "--in-process"],
            ["--in-process", "--uavs", "4", "--duration", "25"],
        )
    )
    sweep = ["sweep", "uavs=2,3", "--seeds", "2", "--duration", "3", "--jobs", "2", "--quiet"]
    printed(meanflock, *sweep, "--out", tmp_path / "sweep", cwd=working)
    said = ended(meanflock, "paper", "--seeds", "1", cwd=working)
    assert (said.returncode, said.stdout, said.stderr.count("\n")) == (EXIT_BAD_INPUT, "", 1)
    assert said.stderr.startswith("error: paper: the folder `research` is missing")
    assert not ran.exists(), ran.read_text()
    assert (each["mode"], alone["mode"]) == ("processes", "in-process")
    assert (each["method"], each["ticks"], each["lost"], each["dropped_messages"]) == ("spring", 100, 0, {})
    assert sorted(path.name for path in working.iterdir()) == sorted(
        [*PACKAGES, *(f"{name}.py" for name in (*PACKAGES, *LIBRARIES))]
    )
    ours = mf.fly(plugin=SPRING, method="spring", uavs=3, duration=10).summary["trajectory_sha256"]
    assert each["trajectory_sha256"] == alone["trajectory_sha256"] == ours
    assert federated["rounds"] > 0
    assert federated["trajectory_sha256"] == mf.fly(uavs=4, duration=25).summary["trajectory_sha256"]
    assert (federated["backend"], alone["backend"]) == (mf.fly(uavs=1, duration=1).summary["backend"],) * 2
    printed(meanflock, "plot", tmp_path / "out" / federated["run_id"], cwd=working)


@pytest.mark.parametrize("python", ["newest"], indirect=True)
def test_it_records_and_a_type_checker_sees_its_types_and_accepts_the_pages(python: Path, tmp_path: Path) -> None:
    printed(python.with_name("meanflock"), "run", "--in-process", "--duration", "5", cwd=tmp_path)
    (folder,) = (tmp_path / "runs").iterdir()
    assert (folder / "recording.rrd").stat().st_size > 0
    for page in PAGES:
        for name, code in modules_of(page).items():
            (tmp_path / name).write_text(code, encoding="utf-8")
    (tmp_path / "reveal.py").write_text("import meanflock as mf\n\nreveal_type(mf.fly(uavs=2).states)\n")
    for interpreter in (sys.executable, python):
        seen = printed(sys.executable, "-m", "mypy", "--python-executable", interpreter, tmp_path, cwd=tmp_path)
        assert 'numpy.dtype[numpy.float64]]"' in seen
