"""Plug-ins of the command line: the list, new packages, copies that a run keeps; ones that raise or print."""

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any, get_args

import pytest

import meanflock as mf
from meanflock.cli import scaffold
from meanflock.launch.engine import Engine
from meanflock.results.flown_plugins import FOLDER
from meanflock.results.run_folder import RunFolder
from meanflock.swarm import plugins
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, BadInput
from meanflock.swarm.plugins import Plugin, registry
from meanflock.swarm.scenario import load
from tests.commands import ended, printed
from tests.controller_files import controller_file
from tests.faults.dying import dead
from tests.testing.good import KINDS, having

SPRING = Path(__file__).parents[2] / "examples" / "spring.py"
HOVERS = "Hovers as J. Doe et al. did in 1999 (cf. Eq. 3, e.g. of her thesis)."
MINE = '''
"""What is in this file."""
from typing import Annotated, Literal
from msgspec import Meta
from meanflock.agent.controllers.base import Controller, Options

class Mine(Controller):
    """Hovers as J. Doe et al. did in 1999
    (cf. Eq. 3, e.g. of her thesis). And more.

    And still more.
    """
    name = "mine"
    class Options(Options, frozen=True):
        share: Annotated[float, Meta(gt=0, le=1, description="of the battery, 1")]
        kind: Literal["old", "new"] = "new"
        places: tuple[int, ...] | None = None
    def init(self, uavs, plan):
        return {}
    def step(self, memory, tick, own, received):
        raise NotImplementedError
'''


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(MINE)
    return path


def test_the_catalogue_lists_every_plugin_by_kind_in_80_columns_and_as_json(run: Any, mine: Path) -> None:
    code, out, _ = run("plugins", "--plugin", str(SPRING), "--plugin", str(mine))
    listed = {(one["kind"], one["name"]): one for one in json.loads(run("plugins", "--json")[1])}
    assert code == EXIT_DONE
    assert set(listed) == {(plugin.kind, plugin.name) for plugin in plugins.installed()}
    record = listed["controller", "mine"]
    assert (record["source"], record["key"], record["about"], record["fault"]) == (str(mine), "method", HOVERS, None)
    option = {"name": "share", "kind": "number", "bounds": "> 0, ≤ 1", "required": True, "default": None}
    assert record["options"][0] == {**option, "about": "of the battery, 1"}
    assert max(map(len, out.splitlines())) <= max(80, len(str(mine)) + 20)  # a path is not broken
    kinds = [line.partition(":")[0] for line in out.splitlines() if line and not line.startswith(" ")]
    assert kinds == [
        *("controllers", "aggregators", "channels", "vehicles", "learners", "filters", "topologies", "codings"),
    ]
    for plugin in plugins.installed():
        assert f"  {plugin.name}  (" in out
    assert f"    {HOVERS}\n" in out
    assert "And " not in out
    assert "- stiffness = 0.02  number > 0; pull, 1/s²\n" in out
    assert "- share = required  number > 0, ≤ 1; of the battery, 1\n" in out
    assert '- kind = "new"  new | old\n' in out
    assert "- places = null  array | null\n" in out


def test_a_plugin_that_cannot_be_used_is_listed_with_the_reason(monkeypatch: pytest.MonkeyPatch, run: Any) -> None:
    broken = Plugin("controller", "broken", "theirs 1.0", "nowhere.at.all:Broken", "theirs 1.0")
    packaged = {**registry._packaged(), ("controller", "broken"): (broken,)}
    monkeypatch.setattr(registry, "_packaged", lambda: packaged)
    code, out, _ = run("plugins")
    assert code == EXIT_DONE
    assert "  broken  (theirs 1.0)\n    cannot be used: controller 'broken' of theirs 1.0: ModuleNotFoundError" in out


def test_the_schema_has_the_options_of_a_controller(run: Any, mine: Path) -> None:
    code, out, _ = run("scenario", "schema", "--method", "mine", "--plugin", str(mine))
    assert code == EXIT_DONE
    whole = json.loads(out)
    properties = whole["$defs"]["Scenario"]["properties"]
    assert properties["method"]["const"] == "mine"
    options = whole["$defs"][properties["controller"]["$ref"].removeprefix("#/$defs/")]
    assert options["required"] == ["share"]
    assert options["properties"]["share"]["exclusiveMinimum"] == 0
    assert options["additionalProperties"] is False


def test_a_run_keeps_the_plugin_file_and_is_resumed_once_that_is_named(run: Any, tmp_path: Path) -> None:
    plugins.load_file(SPRING)
    flown = load(None, ['stop="duration"', "duration=15", "uavs=4"], method="spring")
    expected = Engine(flown, "run").complete()["trajectory_sha256"]
    folder = dead(tmp_path, flown, 130)
    copy = folder / FOLDER / "spring.py"
    assert copy.read_bytes() == SPRING.read_bytes()

    registry.registered.clear()  # a new process, that was not told of the file
    go_on = ("resume", str(folder), "--in-process", "--quiet", "--no-record", "--json")
    code, _, err = run(*go_on)
    assert code == EXIT_BAD_INPUT
    assert "controller 'spring' is not installed here" in err
    assert f"meanflock resume {folder} --plugin {copy}" in err
    assert not registry.registered  # nothing was imported from the folder
    (tmp_path / "spring.py").write_text(SPRING.read_text() + "\n")
    code, _, err = run(*go_on, "--plugin", str(tmp_path / "spring.py"))
    assert f"controller 'spring' of {plugins.fingerprint(copy.read_bytes())}; here it is of " in err
    assert err.endswith(f"meanflock resume {folder} --plugin {copy}\n")
    registry.registered.clear()
    code, out, _ = run(*go_on, "--plugin", str(copy))
    assert code == EXIT_DONE
    assert json.loads(out)["trajectory_sha256"] == expected

    registry.registered.clear()
    code, _, err = run(*go_on)
    assert (code, "this run has finished" in err) == (EXIT_BAD_INPUT, True)


def test_a_plugin_file_that_changed_since_it_was_loaded_is_refused(mine: Path, tmp_path: Path) -> None:
    plugins.load_file(mine)
    flown = load(None, ["controller.share=0.5"], method="mine")
    mine.write_text(MINE.replace("Hovers", "Falls"))
    with pytest.raises(BadInput, match=r"mine\.py: was changed since it was loaded"):
        RunFolder(tmp_path / "out", "run", flown)
    assert not (tmp_path / "out").exists()


@pytest.mark.processes
@pytest.mark.xdist_group("packaging")
def test_new_packages_of_all_kinds_install_conform_and_fly(run, tmp_path, monkeypatch) -> None:
    names = {kind: f"swirl_{kind}" for kind in get_args(scaffold.Kind)}
    for kind, name in names.items():
        code, out, _ = run("new", kind, name)
        assert (code, f"Next: pip install -e './{name}[test]'\n      python -m pytest {name}\n" in out) == (
            EXIT_DONE,
            True,
        )
        written = [line for line in out.splitlines() if line.startswith(f"{name}/")]
        assert [line for line in written if not (tmp_path / line).is_file()] == []
    # The build backend lies in a folder of its own, so that packages are built without an environment each.
    backend, site = tmp_path / "backend", tmp_path / "site"
    install = (sys.executable, "-m", "pip", "install", "-q", "--target")
    printed(*install, backend, "setuptools>=77")
    packages = [f"./{name}" for name in names.values()]
    build = ("--no-deps", "--no-build-isolation", *packages)
    printed(*install, site, *build, env=os.environ | {"PYTHONPATH": str(backend)})
    monkeypatch.setenv("PYTHONPATH", str(site))
    passed = f"{2 * len(names)} passed"
    assert passed in printed(sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", *packages)
    short = ("--quiet", "--no-record", "--uavs", "4", "--duration", "25")
    lines = [[*scaffold.flight(kind, name).split()[1:], *short] for kind, name in names.items()]
    flies = f"from meanflock.cli.command import main\nassert not any([main(line) for line in {lines}])"
    printed(sys.executable, "-P", "-c", flies)
    flown = [json.loads(path.read_text()) for path in tmp_path.glob("runs/*/summary.json")]
    assert [(summary["uavs"], summary["lost"]) for summary in flown] == [(4, 0)] * len(names)


class Odd(BaseException):
    pass


# Kind and method that raises, and the exit code: before take-off, in flight, or of a round, which it costs and no more.
RAISES = {
    **dict.fromkeys(
        [("controller", name) for name in ("Options", "__init__", "weights", "init", "prediction")], EXIT_BAD_INPUT
    ),
    **dict.fromkeys([("aggregator", "init"), ("vehicle", "init")], EXIT_BAD_INPUT),
    **dict.fromkeys([("controller", "step"), ("filter", "admit"), ("channel", "transmit")], EXIT_RUN_FAILED),
    **dict.fromkeys([("channel", "expected"), ("vehicle", "step"), ("vehicle", "power")], EXIT_RUN_FAILED),
    ("aggregator", "step"): EXIT_DONE,
}
KEYS = ("filter.kind", "federation.aggregation", "radio.model", "vehicle.model")
ALL_GOOD = [word for key in KEYS for word in ("--set", f"{key}=good")]
FLIGHT = ("run", "--in-process", "--method", "good", "--uavs", "2", "--duration", "1", "--quiet", "--out", "runs")


@pytest.mark.parametrize("raised", [RuntimeError("no"), SystemExit(0), Odd("no")], ids=repr)
def test_a_command_ends_with_one_error_whatever_a_plugin_raises(run, tmp_path, raised: BaseException) -> None:
    def fail(*_: object) -> None:
        raise raised

    def check(code: int, *flags: str) -> None:
        left, _, told = run(*FLIGHT, *ALL_GOOD, *flags)
        errors = [line for line in told.splitlines() if line.startswith("error: ")]
        assert (left, len(errors)) == (code, int(code != EXIT_DONE)), told
        assert "Traceback" not in told
        assert code != EXIT_BAD_INPUT or not (tmp_path / "runs").exists()
        shutil.rmtree(tmp_path / "runs", ignore_errors=True)
        assert code == EXIT_DONE or type(raised).__name__ in errors[0]

    options = type("Options", (mf.Options,), {"__post_init__": fail}, frozen=True)
    members = {"weights": property(fail), "Options": options}
    for (exported, method), code in RAISES.items():
        for name, kind in KINDS.items():
            good = having(kind.good, period_ticks=4)
            plugins.register(having(good, **{method: members.get(method, fail)}) if name == exported else good)
        check(EXIT_RUN_FAILED if isinstance(raised, Odd) else code)
    for kind in KINDS.values():
        plugins.register(kind.good)
    check(EXIT_DONE)
    (tmp_path / "mine.py").write_text(f"class Odd(BaseException):\n    pass\n\nraise {raised!r}\n")
    check(EXIT_RUN_FAILED if isinstance(raised, Odd) else EXIT_BAD_INPUT, "--plugin", "mine.py")


NOISY = """
import os, threading, time

print("imported")
os.write(1, b"as native code does")
threading.Thread(target=time.sleep, args=(1e6,)).start()
"""
NOISY_FLIGHT = ("run", "--method", "noisy", "--uavs", "2", "--duration", "1", "--no-record", "--quiet")


@pytest.mark.processes
@pytest.mark.parametrize("command", [NOISY_FLIGHT, ("plugins",)], ids=["run", "list"])
def test_standard_output_is_json_alone(tmp_path: Path, command: tuple[str, ...]) -> None:
    noisy = controller_file(tmp_path, "noisy", 'print("tick", tick)\nreturn mf.Step(memory, -0.02 * own[:, :2])', NOISY)
    done = ended(sys.executable, "-m", "meanflock", *command, "--plugin", noisy, "--json", cwd=tmp_path)
    assert (done.returncode, "imported" in done.stderr) == (0, True), done.stderr
    found = json.loads(done.stdout)
    assert found["ticks"] == 10 if command[0] == "run" else "noisy" in {entry["name"] for entry in found}


USED = ("--method", "mine")
UNUSED = (
    "warning: --plugin mine.py: this flight uses no controller 'mine' and no channel 'clear'; to fly it, add "
    "--set method=mine or --set radio.model=clear"
)
CHANNEL = "\nclass Clear(mf.Channel):\n    name = 'clear'\n\n    def transmit(self, distance_m, bits, rng): ...\n"


@pytest.mark.parametrize(
    ("flags", "warned"),
    [((), [UNUSED]), (USED, []), (("--set", 'groups=[{name="a",count=2,method="mine"}]'), [])],
)
def test_a_flight_warns_of_a_plugin_file_that_it_does_not_use(run, tmp_path, flags, warned) -> None:
    path = controller_file(tmp_path, "mine", "return mf.Step(memory, 0.0 * own[:, :2])")
    path.write_text(path.read_text() + CHANNEL)
    flight = ("--plugin", path.name, "--uavs", "2", "--duration", "1", "--in-process", "--no-record", "--quiet")
    code, _, err = run("run", *flight, *flags)
    assert (code, [line for line in err.splitlines() if line.startswith("warning: ")]) == (EXIT_DONE, warned)
