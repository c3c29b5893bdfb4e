"""Plug-ins, of packages and of files: which are found, which are refused; and the network can name one, but no file."""

import os
import re
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.plan import plan_of
from meanflock.swarm import plugins, scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins import Plugin, registry
from tests.controller_files import controller_text

GOOD = controller_text("mine", "return mf.Step(memory, -own[:, 2:])")


def written(folder: Path, text: str, name: str = "mine.py") -> Path:
    (path := folder / name).write_text(text, encoding="utf-8")
    return path


# -- names ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../mine", "a b", ".", "-x", "ä", "a*", "x" * 65, "a\nb"])
def test_a_name_that_could_not_be_part_of_a_file_name_is_refused(name: str) -> None:
    with pytest.raises(BadInput, match=r"a name is up to 64 of A-Z, a-z, 0-9"):
        plugins.register(type("Mine", (mf.Controller,), {"name": name, "step": lambda *_: None}))


@pytest.mark.parametrize("kind", plugins.GROUPS)
def test_a_misspelt_name_is_answered_with_the_one_that_is_meant(kind: plugins.PluginKind) -> None:
    for name in plugins.names(kind):
        with pytest.raises(BadInput, match=f"is not installed here; did you mean '{name}'[?] Else install"):
            plugins.find(kind, name.replace("-", "") + "_")
    with pytest.raises(BadInput, match="is not installed here; install its package, or name its file"):
        plugins.find(kind, "/etc/passwd")
    with pytest.raises(BadInput, match=r"load the file with --plugin my/own.py, and give the `name` of its class"):
        plugins.find(kind, "my/own.py")


@pytest.mark.parametrize("method", ["/etc/passwd", "mine.py", "os:system", ""])
def test_a_scenario_from_the_network_names_a_plugin_and_no_file_and_no_module(method, tmp_path, monkeypatch) -> None:
    written(tmp_path, "raise AssertionError('it was run')")
    monkeypatch.chdir(tmp_path)
    for key in ("plugin", "plugins", "plugin_files"):
        with pytest.raises(BadInput, match=key):
            scenario.decode(msgspec.json.encode({key: ["mine.py"]}))
    received = scenario.decode(msgspec.json.encode({"method": method}))
    with pytest.raises(BadInput, match="is not installed here"):
        plan_of(received)


# -- packages -------------------------------------------------------------------------------------------------------


def test_two_packages_of_one_name_are_refused_with_both_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    both = tuple(Plugin("controller", "twice", f"package-{k} 1.0", f"of_{k}:Mine", f"{k}") for k in "ab")
    monkeypatch.setattr(registry, "_packaged", lambda: {("controller", "twice"): both})
    with pytest.raises(BadInput, match=r"named 'twice': of_a:Mine \(package-a 1.0\) and of_b:Mine \(package-b 1.0\)"):
        plugins.find("controller", "twice")


@pytest.mark.parametrize(
    ("reference", "text"),
    [
        ("nothing_of_the_kind:Mine", "ModuleNotFoundError"),
        ("of_a_stranger:Odd", r"SystemExit: no such device \(of_a_stranger.py, line 1\)"),
        ("meanflock.swarm.plugins:find", "is a function; it must be a class"),
        ("meanflock.swarm.plugins:Plugin", "lacks `init` and `step`"),
    ],
)
def test_a_package_whose_entry_point_is_of_no_use_is_named(reference, text, tmp_path, monkeypatch) -> None:
    written(tmp_path, "raise SystemExit('no such device')", "of_a_stranger.py")
    monkeypatch.syspath_prepend(tmp_path)
    plugin = Plugin("controller", "odd", "odd-package 2.0", reference, "odd-package 2.0")
    monkeypatch.setattr(registry, "_packaged", lambda: {("controller", "odd"): (plugin,)})
    with pytest.raises(BadInput, match=f"'odd' of odd-package 2.0.*{text}"):
        plugins.load("controller", "odd")


# -- methods --------------------------------------------------------------------------------------------------------


class Fitting(mf.Learner):
    name = "fitting"

    @classmethod
    def initial(cls, options, scenario):
        return {}

    def fit(self, model, config):
        return None


@pytest.mark.parametrize(
    ("method", "written", "expected"),
    [
        ("fit", lambda self, model: None, r"`fit` takes \(self, model\); write fit\(self, model, config\)$"),
        ("fit", staticmethod(lambda model: None), r"`fit` takes \(model\); write fit\(self, model, config\)$"),
        ("load", lambda self: None, r"`load` takes \(self\); write load\(self, raw\)$"),
        ("__init__", lambda self, options: None, r"write __init__\(self, options, scenario, uav\)$"),
        ("initial", lambda self, options, scenario: {}, r"write @classmethod initial\(cls, options, scenario\)$"),
        ("initial", classmethod(lambda cls, options: {}), r"write @classmethod initial\(cls, options, scenario\)$"),
    ],
)
def test_a_method_that_takes_other_arguments_than_that_of_the_base_class_is_refused(method, written, expected) -> None:
    with pytest.raises(BadInput, match=f"learner 'fitting' of this process: .*{expected}"):
        plugins.register(type("Fitting", (Fitting,), {method: written}))


def test_a_method_may_have_arguments_of_other_names_and_further_ones_with_defaults() -> None:
    class Further(Fitting):
        def fit(self, weights, told, *, epochs=3):
            return None

        @staticmethod
        def initial(*given):
            return {}

        def loss(self, labels):
            return 0.0

    plugins.register(Further)


# -- files ----------------------------------------------------------------------------------------------------------


def with_option(option: str) -> str:
    options = f"class Options(mf.Options, frozen=True):\n        {option}"
    imports = "from typing import Annotated\nfrom msgspec import Meta\n"
    return imports + GOOD.replace('name = "mine"', f'name = "mine"\n    {options}')


NUMPY = "import numpy as np\n\nnp.linalg.inv(np.zeros((2, 2)))"
FILES = [  # text of a file, and the error
    ("import nothing_of_the_kind", r"named 'nothing_of.*line 1\); install 'nothing_of_the_kind' in the Python"),
    ("x = 1\ndef (:", r"SyntaxError: invalid syntax \(mine.py, line 2\)"),
    (NUMPY, r"LinAlgError: Singular matrix \(mine.py, line 3\)"),
    (GOOD.replace('name = "mine"', ""), "no plug-in in it; derive a class"),
    (GOOD.replace("def step(self", "def stap(self"), r"controller 'mine' of .*mine.py lacks `step`$"),
    (GOOD.replace('name = "mine"', 'name = "mine"\n    Options = dict'), "`Options` must be a msgspec.Struct"),
    (
        GOOD.replace("memory, tick, own", "memory, own"),
        r"`step` takes \(self, memory, own, received\); write step\(self, memory, tick, own, received\)$",
    ),
    (
        f"{GOOD}\nclass Next(Mine):\n    name = 'next'\n    def __init__(self): pass",
        r"controller 'next' of .*: `__init__` takes \(self\); write __init__\(self, options, scenario\)$",
    ),
    (
        with_option("gain: float = 'x'"),
        r"mine\.py: the default of `gain` in `Options` does not fit its type: .*got `str`",
    ),
    (with_option("gain: Annotated[float, Meta(gt=0)] = 0.0"), "the default of `gain` .*> 0.0; change one of them"),
    (with_option("gain: 'Nothing' = 0.0"), "the default in `Options` .*'Nothing' is not defined"),
    (f"{GOOD}\nclass Taken(Mine):\n    name = 'hjb'\n", "'hjb' is installed already.*another name"),
    (f"{GOOD}\nclass Better(Mine):\n    pass\n", "two controllers are named 'mine', Mine and Better"),
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


def test_a_file_without_a_plugin_is_told_the_base_classes_that_the_package_has(tmp_path: Path) -> None:
    with pytest.raises(BadInput) as caught:
        plugins.load_file(written(tmp_path, "x = 1"))
    (listed,) = re.findall(r"derive a class from meanflock\.(.*) and give", str(caught.value))
    assert all(isinstance(getattr(mf, name), type) for name in re.split(", | or ", listed))


def test_a_file_that_cannot_be_read_or_has_another_ending_is_bad_input(tmp_path: Path) -> None:
    for path in (tmp_path / "nowhere.py", tmp_path):
        with pytest.raises(BadInput, match="name a readable Python file"):
            plugins.load_file(path)
    with pytest.raises(BadInput, match=r"must end in \.py"):
        plugins.load_file(written(tmp_path, GOOD, "mine.txt"))
    (folder := tmp_path / f"a{os.pathsep}b").mkdir()
    with pytest.raises(BadInput, match="may be in its path; give the file another place"):
        plugins.load_files([written(folder, GOOD)])


def test_how_numpy_treats_errors_stays_as_it_was_when_a_file_sets_it(tmp_path: Path) -> None:
    before = np.geterr()
    plugins.load_file(written(tmp_path, f"{GOOD}\nimport numpy as np\nnp.seterr(all='raise')\n"))
    assert np.geterr() == before


def test_a_file_that_changed_within_a_second_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    for number in (1, 2):
        path = written(tmp_path, f"{GOOD}\nMine.number = {number}\nAlso = Mine\n")
        os.utime(path, (1e9, 1e9))  # a file of the same length, of the same second
        plugins.load_file(path)
        assert plugins.load("controller", "mine").number == number
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_replaces_a_registered_class_and_is_refused_beside_another_of_its_name(tmp_path, monkeypatch) -> None:
    plugins.register(type("Mine", (mf.Controller,), {"name": "mine", "step": lambda *_: None}))
    (plugin,) = plugins.load_file(first := written(tmp_path, GOOD))
    assert (plugin.source, plugins.find("controller", "mine")) == (str(first), plugin)
    with pytest.raises(BadInput, match=rf"two controllers are named 'mine', the other in {first}"):
        plugins.load_file(written(tmp_path, GOOD, "other.py"))
    assert plugins.load_file(first)  # the same again is the same
    monkeypatch.chdir(tmp_path)
    assert plugins.load_file(Path(first.name))  # by another path
    assert plugins.find("controller", "mine").source == str(first)
