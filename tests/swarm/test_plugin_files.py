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
from tests.swarm.plugin_files import GOOD, ROOT, written

FILES = {
    "does not import": ("import nothing_of_the_kind", r"ModuleNotFoundError: No module named 'nothing_of.*line 1\)"),
    "is no Python": ("x = 1\ndef (:", r"SyntaxError: invalid syntax \(mine.py, line 2\)"),
    "raises": ("x = 1\n1 / 0", r"ZeroDivisionError: division by zero \(mine.py, line 2\)"),
    "exits": ("raise SystemExit(3)", r"SystemExit: 3"),
    "holds none": ("x = 1", r"no plug-in in it; derive a class"),
    "holds a base class": (GOOD.replace('name = "mine"', ""), r"no plug-in in it; derive a class"),
    "lacks step": (GOOD.replace("def step(self", "def stap(self").replace("(Controller)", "(Lacking)").replace(
        "class Mine", 'class Lacking:\n    door = "controller"\n    Options = Controller.Options\n\nclass Mine'),
        r"controller 'mine' of .*mine.py lacks `step`"),
    "derives from a base class and lacks step": (GOOD.replace("def step(self", "def stap(self"),
        r"controller 'mine' of .*mine.py lacks `step`$"),
    "has options that are no struct": (GOOD.replace('name = "mine"', 'name = "mine"\n    Options = dict'),
        r"`Options` must be a msgspec.Struct"),
    "takes the name of ours": (GOOD.replace('"mine"', '"hjb"'), r"'hjb' is installed already.*another name"),
}  # fmt: skip


@pytest.mark.parametrize("what", FILES)
def test_a_file_that_is_no_plugin_is_bad_input_of_one_line_with_the_file_and_the_place(
    what: str, tmp_path: Path
) -> None:
    text, expected = FILES[what]
    path = written(tmp_path, text)
    with pytest.raises(BadInput, match=expected) as caught:
        plugins.load_file(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert not registry.registered


@pytest.mark.parametrize("path", ["nowhere.py", "."])
def test_a_file_that_cannot_be_read_is_bad_input(path: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="name a readable Python file"):
        plugins.load_file(tmp_path / path)


def test_a_file_that_is_not_called_so_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"must end in \.py"):
        plugins.load_file(written(tmp_path, GOOD, "mine.txt"))


def test_so_is_one_with_a_relative_import(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("from . import helper\n")
    with pytest.raises(BadInput, match=r"attempted relative import .*; a plug-in is one file, or a package: install"):
        plugins.load_file(tmp_path / "mine.py")


def test_a_file_that_wants_another_beside_it_is_told_to_be_a_package(tmp_path: Path) -> None:
    written(tmp_path, "x = 1", "nothing_of_the_kind.py")
    with pytest.raises(BadInput, match=r"line 1\); a plug-in is one file, or a package: install what 'nothing_of"):
        plugins.load_file(written(tmp_path, f"from nothing_of_the_kind.inner import x\n{GOOD}"))


def test_a_file_whose_path_no_variable_could_hold_is_refused(tmp_path: Path) -> None:
    (folder := tmp_path / f"a{os.pathsep}b").mkdir()
    with pytest.raises(BadInput, match="may be in its path; give the file another place"):
        plugins.load_files([written(folder, GOOD)])


def test_a_file_that_changed_is_run_as_it_is_now_however_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    for number in (1, 2, 3):
        path = written(tmp_path, f"{GOOD}\nMine.number = {number}\n")
        os.utime(path, (1e9, 1e9))  # a file of the same length, of the same second
        plugins.load_file(path)
        assert plugins.load("controller", "mine").number == number  # type: ignore[attr-defined]
    assert list(tmp_path.iterdir()) == [path]


def test_two_of_one_name_are_refused_with_both_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugins.load_file(first := written(tmp_path, GOOD))
    with pytest.raises(BadInput, match="two controllers are named 'mine'") as caught:
        plugins.load_file(second := written(tmp_path, GOOD, "other.py"))
    assert str(first) in str(caught.value)
    assert str(second) in str(caught.value)
    assert plugins.load_file(first)  # the same again is the same
    monkeypatch.chdir(tmp_path)
    assert plugins.load_file(Path(first.name))  # by whatever path


def test_a_file_takes_the_place_of_the_class_that_a_notebook_had_of_it(tmp_path: Path) -> None:
    plugins.register(type("Mine", (mf.Controller,), {"name": "mine", "step": lambda *_: None}))
    (plugin,) = plugins.load_file(path := written(tmp_path, GOOD))
    assert (plugin.source, plugins.find("controller", "mine")) == (str(path), plugin)


TWICE = f"""{GOOD}
class Better(Mine):
    pass
"""


def test_two_of_one_name_in_a_file_are_refused_and_another_name_for_one_of_them_is_not(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"two controllers are named 'mine', Mine and Better; give one of them another"):
        plugins.load_file(written(tmp_path, TWICE))
    assert not registry.registered
    plugins.load_file(written(tmp_path, f"{GOOD}\nAlso = Mine\n"))
    assert [plugin.name for plugin, _ in registry.registered.values()] == ["mine"]


def test_a_file_one_of_whose_plugins_is_refused_leaves_all_as_it_was(tmp_path: Path) -> None:
    taken = "\nclass Taken(Mine):\n    name = 'hjb'\n"
    with pytest.raises(BadInput, match="'hjb' is installed already"):
        plugins.load_file(written(tmp_path, GOOD + taken))
    assert not registry.registered


def test_a_file_is_the_same_one_however_it_was_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, GOOD)
    plugins.load_files([path.name])  # of the variable, say
    plugins.load_file(path)
    assert plugins.find("controller", "mine").source == str(path)


def test_the_place_of_an_error_is_in_the_plugin_and_not_in_what_it_calls(tmp_path: Path) -> None:
    text = "import numpy as np\n\nnp.linalg.inv(np.zeros((2, 2)))"
    with pytest.raises(BadInput, match=r"LinAlgError: Singular matrix \(mine.py, line 3\)"):
        plugins.load_file(written(tmp_path, text))


# -- on the command line ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("import nothing_of_the_kind", "ModuleNotFoundError"),
        (GOOD.replace("return {}", "raise OSError('no table')"), "failed in `init` with UAV 0"),
    ],
    ids=["does not import", "raises in init"],
)
def test_a_plugin_that_cannot_begin_ends_the_command_with_exit_code_2_and_one_line(
    text: str, expected: str, tmp_path: Path
) -> None:
    command = [str(Path(sys.executable).with_name("meanflock")), "run", "--in-process", "--quiet", "--method", "mine"]
    command += ["--plugin", str(written(tmp_path, text)), "--set", "uavs=2", "--out", str(tmp_path / "runs")]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=dict(os.environ), timeout=DEADLINE_S)
    assert ended.returncode == EXIT_BAD_INPUT, ended.stderr
    assert expected in ended.stderr
    assert "Traceback" not in ended.stderr
    assert not list((tmp_path / "runs").glob("*/summary.json"))


@pytest.mark.processes
@pytest.mark.parametrize(
    ("text", "more", "expected"),
    [
        (GOOD.replace("return {}", "raise OSError('no table')"), (), "failed in `init` with UAV 0: OSError: no table"),
        (
            GOOD.replace("return {}", "return {} if 1 not in uavs else 1 / 0"),
            (),
            "failed in `init` with UAV 1: ZeroDivisionError",
        ),
        (GOOD, ("--set", "vehicle.options.mass=2"), "vehicle.options: there is no key `mass`"),
        (GOOD, ("--set", "federation.options.beta=2"), "federation.options: there is no key `beta`"),
    ],
    ids=["in every init", "in the init of one", "a vehicle's option", "a rule's option"],
)
def test_what_only_another_process_finds_out_is_bad_input_all_the_same_and_leaves_no_folder(
    text: str, more: tuple[str, ...], expected: str, tmp_path: Path
) -> None:
    command = [str(Path(sys.executable).with_name("meanflock")), "run", "--quiet", "--method", "mine", *more]
    command += ["--plugin", str(written(tmp_path, text)), "--set", "uavs=2", "--out", str(tmp_path / "runs")]
    ended = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ), timeout=DEADLINE_S)
    assert ended.returncode == EXIT_BAD_INPUT, ended.stderr
    (line,) = ended.stderr.splitlines()
    assert line.startswith("error: ")
    assert expected in line
    assert not (tmp_path / "runs").exists()
