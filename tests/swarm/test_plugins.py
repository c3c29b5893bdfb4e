"""Plug-ins by name: those that are found and refused; the network can name one and no file."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

import meanflock as mf
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins, scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.net import client
from meanflock.swarm.plugins import Plugin, registry
from meanflock.swarm.scenario import load
from tests.swarm.plugin_files import SPRING, written


@pytest.mark.parametrize("name", ["../mine", "a/b", "a b", ".", "-x", "ä", "a*", "x" * 65, "a\nb"])
def test_a_name_that_could_not_be_part_of_a_file_name_is_refused(name: str) -> None:
    with pytest.raises(BadInput, match=r"a name is up to 64 of A-Z, a-z, 0-9"):
        plugins.register(type("Mine", (mf.Controller,), {"name": name, "step": lambda *_: None}))


@pytest.mark.parametrize(
    ("base", "needed"),
    [
        ("Controller", ["step"]),
        ("Aggregator", ["step"]),
        ("Channel", ["transmit"]),
        ("Vehicle", ["power", "step"]),
        ("Filter", ["admit"]),
    ],
)
def test_a_class_is_found_by_its_name_once_it_has_the_methods_of_its_kind(base: str, needed: list[str]) -> None:
    lacking = type("Mine", (getattr(mf, base),), {"name": "mine"})
    with pytest.raises(BadInput, match=f"lacks {' and '.join(f'`{method}`' for method in needed)}$"):
        plugins.register(lacking)
    mine = type("Mine", (lacking,), dict.fromkeys(needed, lambda *_: None))
    plugin = plugins.register(mine)
    assert plugins.load(plugin.kind, "mine") is mine
    assert plugin.kind == base.lower()


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
        ("meanflock.swarm.plugins:Nobody", "AttributeError"),
        ("meanflock.swarm.plugins:find", "is a function; it must be a class"),
        ("meanflock.swarm.plugins:Plugin", "lacks `init` and `step`"),
    ],
)
def test_a_package_whose_entry_point_is_of_no_use_is_named(
    reference: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path, "raise SystemExit('no such device')", "of_a_stranger.py")
    monkeypatch.syspath_prepend(tmp_path)
    plugin = Plugin("controller", "odd", "odd-package 2.0", reference, "odd-package 2.0")
    monkeypatch.setattr(registry, "_packaged", lambda: {("controller", "odd"): (plugin,)})
    with pytest.raises(BadInput, match=text) as caught:
        plugins.load("controller", "odd")
    assert "'odd' of odd-package 2.0" in str(caught.value)
    assert "registry.py" not in str(caught.value)


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("controller.stiffness=-1", r"controller\.stiffness: .*> 0"),
        ("controller.stiffness=soft", r"controller\.stiffness: expected a number, got 'soft'"),
        ("controller.stifness=1", r"controller: .*`stifness`; did you mean `controller\.stiffness`\?"),
    ],
)
def test_options_that_do_not_fit_are_named_with_how_to_list_them(setting: str, expected: str) -> None:
    plugins.load_file(SPRING)
    with pytest.raises(BadInput, match=expected) as caught:
        load(None, [setting], method="spring").declared  # noqa: B018
    assert "`meanflock scenario schema --method spring` lists the options" in str(caught.value)


@pytest.mark.parametrize("door", plugins.GROUPS)
def test_a_misspelt_name_is_answered_with_the_one_that_is_meant(door: plugins.Door) -> None:
    for name in plugins.names(door):
        with pytest.raises(BadInput, match=f"is not installed here; did you mean '{name}'[?] Else install"):
            plugins.find(door, name.replace("-", "") + "_")
    with pytest.raises(BadInput, match="is not installed here; install its package, or name its file"):
        plugins.find(door, "/etc/passwd")


@pytest.mark.parametrize("method", ["/etc/passwd", "../mine.py", "mine.py", "os:system", "os.system", "", "."])
def test_a_scenario_from_the_network_names_a_plugin_and_no_file_and_no_module(
    method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path, "raise AssertionError('it was run')")
    monkeypatch.chdir(tmp_path)
    for key in ("plugin", "plugins", "plugin_files"):
        with pytest.raises(BadInput, match=key):
            scenario.decode(msgspec.json.encode({key: ["mine.py"]}))
    received = scenario.decode(msgspec.json.encode({"method": method}))
    with pytest.raises(BadInput, match="is not installed here"):
        received.declared  # noqa: B018


@pytest.mark.parametrize(("kind", "name"), [("controller", "hjb"), ("filter", "ecbf")])
def test_a_node_with_another_version_of_a_plugin_is_refused_with_its_host(
    kind: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class OtherVersions:
        GROUPS = plugins.GROUPS

        @staticmethod
        def find(door: Any, name: str) -> Plugin:
            found = plugins.find(door, name)
            return found._replace(fingerprint="sha256 of another file") if door == kind else found

    monkeypatch.setattr(client, "plugins", OtherVersions)
    monkeypatch.setattr(client.platform, "node", lambda: "far-away")
    with pytest.raises(BadInput, match=f"agent-0 on host far-away: {kind} '{name}' is "):
        Engine(load(None, ["uavs=2", "filter.kind=ecbf"], method="hjb"), "hosts")
