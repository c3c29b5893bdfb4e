"""Plug-ins by name: what is found, what is refused, and that the network can name one and nothing more."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Controller
from meanflock.groundstation.engine import Engine
from meanflock.swarm import plugins, scenario
from meanflock.swarm.errors import EXIT_BAD_INPUT, BadInput
from meanflock.swarm.net import client
from meanflock.swarm.plugins import Plugin
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Refusal
from tests.polling import DEADLINE_S

ROOT = Path(__file__).parents[2]
SPRING = ROOT / "examples" / "spring.py"
GOOD = """
import numpy as np
from meanflock.agent.controllers.base import Controller, Step

class Mine(Controller):
    name = "mine"

    def init(self, uavs, plan):
        return {}

    def step(self, memory, tick, own, received):
        return Step(memory, -own[:, 2:])
"""


@pytest.fixture(autouse=True)
def _nothing_stays(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(plugins, "_files", dict(plugins._files))
    monkeypatch.setenv(plugins.FILES, "")
    return


def written(folder: Path, text: str, name: str = "mine.py") -> Path:
    (path := folder / name).write_text(text, encoding="utf-8")
    return path


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
    assert not plugins._files


@pytest.mark.parametrize("path", ["nowhere.py", "."])
def test_a_file_that_cannot_be_read_is_bad_input(path: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="name a readable Python file"):
        plugins.load_file(tmp_path / path)


def test_a_file_that_is_not_called_so_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"must end in \.py"):
        plugins.load_file(written(tmp_path, GOOD, "mine.txt"))


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
    assert not plugins._files
    plugins.load_file(written(tmp_path, f"{GOOD}\nAlso = Mine\n"))
    assert [plugin.name for plugin, _ in plugins._files.values()] == ["mine"]


def test_a_file_one_of_whose_plugins_is_refused_leaves_all_as_it_was(tmp_path: Path) -> None:
    taken = "\nclass Taken(Mine):\n    name = 'hjb'\n"
    with pytest.raises(BadInput, match="'hjb' is installed already"):
        plugins.load_file(written(tmp_path, GOOD + taken))
    assert not plugins._files


@pytest.mark.parametrize("name", ["../mine", "a/b", "a b", ".", "-x", "ä", "a*", "x" * 65, "a\nb"])
def test_a_name_that_could_not_be_part_of_a_file_s_is_refused(name: str) -> None:
    with pytest.raises(BadInput, match=r"a name is up to 64 of A-Z, a-z, 0-9"):
        plugins.register(type("Mine", (mf.Controller,), {"name": name, "step": lambda *_: None}))


def test_a_file_is_the_same_one_however_it_was_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, GOOD)
    plugins.load_files([path.name])  # of the variable, say
    plugins.load_file(path)
    assert plugins.find("controller", "mine").source == str(path)


@pytest.mark.parametrize("base", ["Controller", "Aggregator", "Channel", "Vehicle"])
def test_a_class_derived_from_each_of_the_four_base_classes_is_found_by_its_name(base: str) -> None:
    methods = {method: lambda *_: None for method in ("step", "transmit", "power")}
    mine = type("Mine", (getattr(mf, base),), {"name": "mine", **methods})
    plugin = plugins.register(mine)
    assert plugins.load(plugin.door, "mine") is mine
    assert plugin.door == base.lower()


@pytest.mark.parametrize(
    ("base", "lacks"),
    [
        ("Controller", "lacks `step`"),
        ("Aggregator", "lacks `step`"),
        ("Channel", "lacks `transmit`"),
        ("Vehicle", "lacks `power` and `step`"),
        ("Filter", "lacks `admit`"),
    ],
)
def test_a_class_that_leaves_out_what_its_base_class_leaves_open_is_refused(base: str, lacks: str) -> None:
    with pytest.raises(BadInput, match=f"{lacks}$"):
        plugins.register(type("Mine", (getattr(mf, base),), {"name": "mine"}))


def test_two_packages_of_one_name_are_refused_with_both_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    both = tuple(Plugin("controller", "twice", f"package-{k} 1.0", f"of_{k}:Mine", f"{k}") for k in "ab")
    monkeypatch.setattr(plugins, "_packaged", lambda: {("controller", "twice"): both})
    with pytest.raises(BadInput, match=r"named 'twice': of_a:Mine \(package-a 1.0\) and of_b:Mine \(package-b 1.0\)"):
        plugins.find("controller", "twice")


@pytest.mark.parametrize(
    ("reference", "text"),
    [
        ("nothing_of_the_kind:Mine", "ModuleNotFoundError"),
        ("meanflock.swarm.plugins:Nobody", "AttributeError"),
        ("meanflock.swarm.plugins:find", "is a function; it must be a class"),
        ("meanflock.swarm.plugins:Plugin", "lacks `init` and `step`"),
    ],
)
def test_a_package_whose_entry_point_is_of_no_use_is_named(
    reference: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = Plugin("controller", "odd", "odd-package 2.0", reference, "odd-package 2.0")
    monkeypatch.setattr(plugins, "_packaged", lambda: {("controller", "odd"): (plugin,)})
    with pytest.raises(BadInput, match=text) as caught:
        plugins.load("controller", "odd")
    assert "'odd' of odd-package 2.0" in str(caught.value)
    assert "line" not in str(caught.value)  # of ours that looks for it


def test_a_package_that_ends_the_process_when_it_is_imported_is_bad_input_with_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path, "raise SystemExit('no such device')", "of_a_stranger.py")
    monkeypatch.syspath_prepend(tmp_path)
    plugin = Plugin("controller", "odd", "odd-package 2.0", "of_a_stranger:Odd", "odd-package 2.0")
    monkeypatch.setattr(plugins, "_packaged", lambda: {("controller", "odd"): (plugin,)})
    with pytest.raises(BadInput, match=r"odd-package 2.0: SystemExit: no such device \(of_a_stranger.py, line 1\)"):
        plugins.load("controller", "odd")


def test_the_place_of_an_error_is_in_the_plugin_and_not_in_what_it_calls(tmp_path: Path) -> None:
    text = "import numpy as np\n\nnp.linalg.inv(np.zeros((2, 2)))"
    with pytest.raises(BadInput, match=r"LinAlgError: Singular matrix \(mine.py, line 3\)"):
        plugins.load_file(written(tmp_path, text))


OPTIONS = {
    "beyond a bound": ("controller.stiffness=-1", r"controller\.stiffness: .*> 0"),
    "of another type": ("controller.stiffness=soft", r"controller\.stiffness: expected a number, got text"),
    "unknown": ("controller.stifness=1", r"controller: .*`stifness`; did you mean `controller\.stiffness`\?"),
}


@pytest.mark.parametrize("what", OPTIONS)
def test_options_that_do_not_fit_are_named_with_how_to_list_them(what: str) -> None:
    plugins.load_file(SPRING)
    setting, text = OPTIONS[what]
    with pytest.raises(BadInput, match=text) as caught:
        load(None, [setting], method="spring").declared  # noqa: B018
    assert "`meanflock scenario schema --method spring` lists the options" in str(caught.value)


# -- over the network ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["/etc/passwd", "../mine.py", "mine.py", "os:system", "os.system", "", "."])
def test_a_scenario_from_the_network_names_a_plugin_and_no_file_and_no_module(
    method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path, "raise AssertionError('it was run')")
    monkeypatch.chdir(tmp_path)
    received = scenario.decode(msgspec.json.encode({"method": method}))
    with pytest.raises(BadInput, match="is not installed here"):
        received.declared  # noqa: B018


@pytest.mark.parametrize("key", ["plugin", "plugins", "plugin_files"])
def test_a_scenario_from_the_network_has_no_key_that_names_a_file(key: str) -> None:
    with pytest.raises(BadInput, match=key):
        scenario.decode(msgspec.json.encode({key: ["mine.py"]}))


class Lent(Controller):
    """One that only some hosts have."""

    name = "lent"

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Any:
        return {}


@pytest.mark.parametrize(("lacks", "named"), [("controller", "lent"), ("filter", "ecbf")])
@pytest.mark.parametrize("there", [None, "sha256 of another file"])
def test_a_node_on_a_host_without_the_plugin_or_with_another_is_refused_and_the_host_is_named(
    there: str | None, lacks: str, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugins.register(type("Lent", (Lent,), {"step": lambda *_: None}))
    here, said = plugins.find, []

    def elsewhere(door: Any, name: str) -> Plugin:
        found = here(door, name)
        if door != lacks:
            return found
        if there is None:
            raise BadInput(f"{door} {name!r} is not installed here; install its package")
        return found._replace(fingerprint=there)

    class ElsewherePlugins:
        GROUPS, find = plugins.GROUPS, staticmethod(elsewhere)

    monkeypatch.setattr(client, "plugins", ElsewherePlugins)
    monkeypatch.setattr(client.platform, "node", lambda: "far-away")
    encode = client.control.encode

    def overheard(message: Any) -> bytes:
        said.append(message)
        return encode(message)

    monkeypatch.setattr(client.control, "encode", overheard)
    with pytest.raises(BadInput, match=f"agent-0 on host far-away: {lacks} '{named}' is "):
        Engine(load(None, ["uavs=2", "filter.kind=ecbf"], method="lent"), "hosts")
    assert any(isinstance(message, Refusal) and "far-away" in message.reason for message in said)


def test_a_world_one_of_whose_nodes_lacks_the_plugin_does_not_take_off_and_says_which_host() -> None:
    engine = Engine(load(None, ["uavs=2"], method="hjb"), "hosts")
    world = engine.world
    world._admission.unfit.append("agent-1 on host far-away: controller 'lent' is not installed here")
    world.members._by_name["agent-0"].ready = False
    with pytest.raises(BadInput, match="host far-away"):
        world.gather(0.0)


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
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=dict(os.environ), timeout=120)
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
