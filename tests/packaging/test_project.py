"""The metadata of the project: ranges, constraints, extras, kernels, plug-ins, make targets."""

import importlib
import os
import re
import sys
import tomllib
from importlib import metadata

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from meanflock.swarm.errors import EXIT_BAD_INPUT, LEAN, lacking, needed
from tests.commands import ended, printed
from tests.sources import EXTRAS, PACKAGE, PROJECT, ROOT, direct

CONSTRAINTS = dict(re.findall(r"^([^#\n]+?)==(.*)$", (ROOT / "constraints.txt").read_text(), flags=re.MULTILINE))


def closure(requirements: list[Requirement]) -> set[str]:
    """Canonical names of the requirements and of all they require here, by what is installed."""
    seen: set[tuple[str, frozenset[str]]] = set()
    queue = list(requirements)
    while queue:
        requirement = queue.pop()
        name, extras = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if (name, extras) in seen:
            continue
        seen.add((name, extras))
        for line in metadata.requires(name) or []:
            child = Requirement(line)
            if child.marker is None or any(child.marker.evaluate({"extra": e}) for e in ("", *extras)):
                queue.append(child)
    return {name for name, _ in seen}


# Flower wants other versions of protobuf and rich than the rest, and torch is large: `make learners` tests both.
APART = {"flower", "torch"}
EVERYTHING = direct(PROJECT["dependencies"], *(lines for name, lines in EXTRAS.items() if name not in APART))


@pytest.mark.parametrize("requirement", EVERYTHING, ids=lambda requirement: requirement.name)
def test_a_direct_dependency_has_a_range_and_its_constraint_lies_inside(requirement: Requirement) -> None:
    assert sorted(bound.operator for bound in requirement.specifier) == ["<", ">="]
    assert CONSTRAINTS[canonicalize_name(requirement.name)] in requirement.specifier


def test_learners_have_constraints_of_their_own() -> None:
    text = (ROOT / "constraints-learners.txt").read_text()
    pins = dict(re.findall(r"^([a-z0-9-]+)==([0-9][0-9a-z.]*)$", text, flags=re.MULTILINE))
    assert len(pins) == len(text.splitlines()) - 1
    for requirement in direct(PROJECT["dependencies"], EXTRAS["torch"]):
        assert requirement.name == "meanflock" or pins[canonicalize_name(requirement.name)] in requirement.specifier
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]
    assert {f"{name}=={pin}" for name, pin in pins.items()} >= {one for one in groups["learners"] if "==" in one}


@pytest.mark.parametrize("extra", sorted(APART))
def test_an_extra_apart_has_a_range_and_dev_does_not_contain_it(extra: str) -> None:
    (library,) = direct(EXTRAS[extra])
    assert sorted(bound.operator for bound in library.specifier) == ["<", ">="]
    assert f"meanflock[{extra}]" not in EXTRAS["dev"]
    assert canonicalize_name(library.name) not in CONSTRAINTS


def test_constraints_cover_every_transitive_dependency() -> None:
    assert closure(EVERYTHING) <= CONSTRAINTS.keys(), "run: make constraints"
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert [one for one in lines if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*==[0-9][0-9a-z.+]*", one)] == []


def test_a_process_of_the_swarm_stays_small() -> None:
    base = closure(direct(PROJECT["dependencies"]))
    assert base == {"eclipse-zenoh", "msgpack", "msgspec", "numpy"}
    world = closure(direct(PROJECT["dependencies"], EXTRAS["world"]))
    assert world == base | {"prometheus-client"}


def test_one_wheel_with_all_kernels_is_for_every_python_from_the_first_on() -> None:
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
    assert tools["distutils"]["bdist_wheel"] == {"py-limited-api": "cp311"}
    assert PROJECT["requires-python"] == ">=3.11"
    (extension,) = tools["setuptools"]["ext-modules"]
    assert extension["name"] == "meanflock.kernels._native"
    assert extension["optional"]
    assert extension["py-limited-api"]
    present = {path.relative_to(ROOT).as_posix(): path.read_text() for path in (PACKAGE / "kernels").rglob("*.[ch]")}
    assert present.keys() == {*extension["sources"], *extension["depends"]}  # all enter a source distribution
    (including,) = (text for text in present.values() if "<Python.h>" in text)
    assert "#define Py_LIMITED_API 0x030B0000" in including[: including.index("<Python.h>")]
    assert "$(wildcard meanflock/kernels/*.[ch] meanflock/kernels/*/*.[ch])" in (ROOT / "Makefile").read_text()


@pytest.mark.parametrize(
    ("module", "arguments", "library", "install"),
    [
        ("meanflock", ["--version"], "click", "'meanflock[fly]'"),
        ("meanflock", ["run", "--in-process"], "pyarrow", "'meanflock[fly]'"),
        ("meanflock", ["compare", "mfg", "--uavs=2"], "matplotlib", "'meanflock[ground]'"),
        ("meanflock", ["view", "run"], "rerun", "'meanflock[ground]'"),
        ("meanflock", ["picture", "run", "-o", "p.png"], "rerun", "'meanflock[ground]'"),
        ("meanflock", ["plot", "run"], "matplotlib", "'meanflock[ground]'"),
        ("meanflock", ["list", "--html=p"], "matplotlib", "'meanflock[ground]'"),
        ("meanflock", ["certs", "init", "c"], "cryptography", "'meanflock[ground]'"),
        ("meanflock", ["sweep", "uavs=2,3", "--jobs=1"], "scipy", "'meanflock[ground]'"),
        ("meanflock", ["run", "--in-process", "--record"], "rerun", "'meanflock[ground]'"),
        ("meanflock", ["run", "--view", "--web"], "rerun", "'meanflock[ground]'"),
        ("meanflock", ["run", "--uavs=2", "--tls=c", "--no-record"], "cryptography", "'meanflock[ground]'"),
        ("meanflock", ["export", "run", "--mcap=r"], "mcap", "'meanflock[export]'"),
        ("meanflock", ["export", "run", "--rosbag=r"], "rosbags", "'meanflock[export]'"),
        ("meanflock", ["bridge", "mavlink", "run"], "pymavlink", "'meanflock[mavlink]'"),
        ("meanflock", ["run", "--realtime", "--steer=0"], "pymavlink", "'meanflock[mavlink]'"),
        ("meanflock", ["flower", "app"], "flwr", "'meanflock[flower]'"),
        ("meanflock.agent", ["--run", "bare"], "numpy", "meanflock"),
        ("meanflock.leader", ["--run", "bare"], "msgspec", "meanflock"),
        ("meanflock.worldsim", ["--run", "bare"], "msgpack", "'meanflock[world]'"),
        ("meanflock.groundstation", ["--run", "bare"], "pyarrow", "'meanflock[fly]'"),
    ],
)
def test_a_process_without_a_library_names_what_to_install(module, arguments, library, install, tmp_path) -> None:
    code = f"import sys, runpy; sys.modules[{library!r}] = None; sys.argv = ['-m', *{arguments}]\n"
    code += f"runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    said = ended(sys.executable, "-P", "-c", code, cwd=tmp_path)
    assert (said.returncode, said.stdout, said.stderr.count("\n")) == (EXIT_BAD_INPUT, "", 1), said.stderr
    assert said.stderr.startswith(f"error: {library} is not installed")
    assert f"pip install {install}" in said.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_lean_libraries_are_those_of_the_lean_extra(monkeypatch) -> None:
    declared = {re.split(r"[<>=]", each)[0].replace("-", "_") for each in PROJECT["optional-dependencies"]["fly"]}
    assert declared - {"meanflock[world]"} == LEAN
    error = ModuleNotFoundError("nowhere", name="nowhere")
    assert lacking(error, "a test", "ground").endswith("pip install 'meanflock[ground]'")
    monkeypatch.setattr("meanflock.swarm.errors.LEAN", {"nowhere"})
    assert "pip install 'meanflock[fly]', or 'meanflock[ground]' with recordings" in lacking(error, "a test", "ground")
    assert lacking(error, "a test", "rl").endswith("pip install 'meanflock[rl]'")


def test_a_missing_module_of_ours_or_within_a_library_is_a_defect() -> None:
    for name in ("meanflock.swarm.nothing_of_the_kind", "msgspec.nothing_of_the_kind"):
        with pytest.raises(ModuleNotFoundError), needed("a test"):
            importlib.import_module(name)


def test_every_entry_point_is_the_plug_in_of_its_name() -> None:
    points = PROJECT["entry-points"]
    for group in points.values():
        for name, reference in group.items():
            module, _, attribute = reference.partition(":")
            assert getattr(importlib.import_module(module), attribute).name == name


def test_every_make_target_is_documented() -> None:
    (phony,) = re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    shown = printed("make", "--no-print-directory", cwd=ROOT, env=environment)
    documented = dict(re.findall(r"^  ([a-z-]+) +(\S.*)$", re.sub(r"\x1b\[\d*m", "", shown), re.MULTILINE))
    assert documented.keys() == set(phony.split()) - {"stale"}
