"""Plug-ins by name: what is found, what is refused, and that the network can name one and nothing more."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.controllers.base import Controller
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins, scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.net import client
from meanflock.swarm.plugins import Plugin, registry
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Refusal
from tests.swarm.plugin_files import SPRING, written


@pytest.mark.parametrize("name", ["../mine", "a/b", "a b", ".", "-x", "ä", "a*", "x" * 65, "a\nb"])
def test_a_name_that_could_not_be_part_of_a_file_s_is_refused(name: str) -> None:
    with pytest.raises(BadInput, match=r"a name is up to 64 of A-Z, a-z, 0-9"):
        plugins.register(type("Mine", (mf.Controller,), {"name": name, "step": lambda *_: None}))


@pytest.mark.parametrize("base", ["Controller", "Aggregator", "Channel", "Vehicle"])
def test_a_class_derived_from_each_of_the_four_base_classes_is_found_by_its_name(base: str) -> None:
    methods = {method: lambda *_: None for method in ("step", "transmit", "power")}
    mine = type("Mine", (getattr(mf, base),), {"name": "mine", **methods})
    plugin = plugins.register(mine)
    assert plugins.load(plugin.kind, "mine") is mine
    assert plugin.kind == base.lower()


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
    monkeypatch.setattr(registry, "_packaged", lambda: {("controller", "twice"): both})
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
    monkeypatch.setattr(registry, "_packaged", lambda: {("controller", "odd"): (plugin,)})
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
    monkeypatch.setattr(registry, "_packaged", lambda: {("controller", "odd"): (plugin,)})
    with pytest.raises(BadInput, match=r"odd-package 2.0: SystemExit: no such device \(of_a_stranger.py, line 1\)"):
        plugins.load("controller", "odd")


OPTIONS = {
    "beyond a bound": ("controller.stiffness=-1", r"controller\.stiffness: .*> 0"),
    "of another type": ("controller.stiffness=soft", r"controller\.stiffness: expected a number, got 'soft'"),
    "unknown": ("controller.stifness=1", r"controller: .*`stifness`; did you mean `controller\.stiffness`\?"),
}


@pytest.mark.parametrize("what", OPTIONS)
def test_options_that_do_not_fit_are_named_with_how_to_list_them(what: str) -> None:
    plugins.load_file(SPRING)
    setting, text = OPTIONS[what]
    with pytest.raises(BadInput, match=text) as caught:
        load(None, [setting], method="spring").declared  # noqa: B018
    assert "`meanflock scenario schema --method spring` lists the options" in str(caught.value)


@pytest.mark.parametrize("door", plugins.GROUPS)
def test_a_misspelt_name_is_answered_with_the_one_that_is_meant(door: plugins.Door) -> None:
    for name in plugins.names(door):
        with pytest.raises(BadInput, match=f"is not installed here; did you mean '{name}'[?] Else install"):
            plugins.find(door, name.replace("-", "") + "_")
    with pytest.raises(BadInput, match="is not installed here; install its package, or name its file"):
        plugins.find(door, "/etc/passwd")


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
