"""A file with plug-ins: what is found in it, and what is refused with the place."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import meanflock as mf
from meanflock.swarm import plugins
from meanflock.swarm.errors import EXIT_BAD_INPUT, BadInput
from meanflock.swarm.plugins import registry
from tests.polling import DEADLINE_S
from tests.swarm.plugin_files import GOOD, written

LACKS_STEP = GOOD.replace("def step(self", "def stap(self")
TWICE = f"{GOOD}\nclass Better(Mine):\n    pass\n"
TAKEN = f"{GOOD}\nclass Taken(Mine):\n    name = 'hjb'\n"
FAILS_IN_INIT = GOOD.replace("return {}", "return {} if 1 not in uavs else 1 / 0")
NUMPY = "import numpy as np\n\nnp.linalg.inv(np.zeros((2, 2)))"
FILES = [  # text of a file, and the error
    ("import nothing_of_the_kind", r"ModuleNotFoundError: No module named 'nothing_of.*line 1\)"),
    ("x = 1\ndef (:", r"SyntaxError: invalid syntax \(mine.py, line 2\)"),
    ("x = 1\n1 / 0", r"ZeroDivisionError: division by zero \(mine.py, line 2\)"),
    (NUMPY, r"LinAlgError: Singular matrix \(mine.py, line 3\)"),
    ("raise SystemExit(3)", "SystemExit: 3"),
    ("x = 1", "no plug-in in it; derive a class"),
    (GOOD.replace('name = "mine"', ""), "no plug-in in it; derive a class"),
    (LACKS_STEP, r"controller 'mine' of .*mine.py lacks `step`$"),
    (GOOD.replace('name = "mine"', 'name = "mine"\n    Options = dict'), "`Options` must be a msgspec.Struct"),
    (TAKEN, "'hjb' is installed already.*another name"),
    (TWICE, "two controllers are named 'mine', Mine and Better; give one of them another"),
    ("from . import helper", "attempted relative import .*; a plug-in is one file, or a package: install"),
    (
        f"from beside.inner import x\n{GOOD}",
        r"line 1\); a plug-in is one file, or a package: install the package of 'beside",
    ),
]


@pytest.mark.parametrize(("text", "expected"), FILES)
def test_a_file_that_is_no_plugin_is_bad_input_with_the_place(text: str, expected: str, tmp_path: Path) -> None:
    written(tmp_path, "x = 1", "beside.py")
    path = written(tmp_path, text)
    with pytest.raises(BadInput, match=expected) as caught:
        plugins.load_file(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert not registry.registered


def test_a_file_that_cannot_be_read_or_has_another_ending_is_bad_input(tmp_path: Path) -> None:
    for path in (tmp_path / "nowhere.py", tmp_path):
        with pytest.raises(BadInput, match="name a readable Python file"):
            plugins.load_file(path)
    with pytest.raises(BadInput, match=r"must end in \.py"):
        plugins.load_file(written(tmp_path, GOOD, "mine.txt"))
    (folder := tmp_path / f"a{os.pathsep}b").mkdir()
    with pytest.raises(BadInput, match="may be in its path; give the file another place"):
        plugins.load_files([written(folder, GOOD)])


def test_a_file_that_changed_within_a_second_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    for number in (1, 2, 3):
        path = written(tmp_path, f"{GOOD}\nMine.number = {number}\n")
        os.utime(path, (1e9, 1e9))  # a file of the same length, of the same second
        plugins.load_file(path)
        assert plugins.load("controller", "mine").number == number  # type: ignore[attr-defined]
    assert list(tmp_path.iterdir()) == [path]


def test_two_files_of_one_name_are_refused_with_both_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugins.load_file(first := written(tmp_path, GOOD))
    source = plugins.find("controller", "mine").source
    with pytest.raises(BadInput, match="two controllers are named 'mine'") as caught:
        plugins.load_file(second := written(tmp_path, GOOD, "other.py"))
    assert str(first) in str(caught.value)
    assert str(second) in str(caught.value)
    assert plugins.load_file(first)  # the same again is the same
    monkeypatch.chdir(tmp_path)
    assert plugins.load_file(Path(first.name))  # by another path
    assert plugins.find("controller", "mine").source == source == str(first)


def test_a_file_replaces_the_class_of_a_notebook(tmp_path: Path) -> None:
    plugins.register(type("Mine", (mf.Controller,), {"name": "mine", "step": lambda *_: None}))
    (plugin,) = plugins.load_file(path := written(tmp_path, GOOD))
    assert (plugin.source, plugins.find("controller", "mine")) == (str(path), plugin)


def test_a_second_name_of_a_class_in_a_file_is_accepted(tmp_path: Path) -> None:
    plugins.load_file(written(tmp_path, f"{GOOD}\nAlso = Mine\n"))
    assert [plugin.name for plugin, _ in registry.registered.values()] == ["mine"]


@pytest.mark.parametrize(
    ("text", "flags", "expected"),
    [
        ("import nothing_of_the_kind", ["--in-process"], "ModuleNotFoundError"),
        (GOOD.replace("return {}", "1 / 0"), ["--in-process"], "failed in `init` with UAV 0: ZeroDivisionError"),
        pytest.param(FAILS_IN_INIT, [], "failed in `init` with UAV 1: ZeroDivisionError", marks=pytest.mark.processes),
        pytest.param(
            GOOD,
            ["--set", "vehicle.options.mass=2"],
            "vehicle.options: there is no key `mass`",
            marks=pytest.mark.processes,
        ),
    ],
)
def test_a_plugin_that_cannot_begin_ends_the_command_with_one_line_and_leaves_no_folder(
    text: str, flags: list[str], expected: str, tmp_path: Path
) -> None:
    command = [str(Path(sys.executable).with_name("meanflock")), "run", "--quiet", "--method", "mine", *flags]
    command += ["--plugin", str(written(tmp_path, text)), "--set", "uavs=2", "--out", str(tmp_path / "runs")]
    ended = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ), timeout=DEADLINE_S)
    assert ended.returncode == EXIT_BAD_INPUT, ended.stderr
    (line,) = ended.stderr.splitlines()
    assert line.startswith("error: ")
    assert expected in line
    assert not (tmp_path / "runs").exists()
