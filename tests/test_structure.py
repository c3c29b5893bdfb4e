"""The house as it was drawn: imports flow one way, heavy libraries stay where they belong, nothing is buried."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.polling import DEADLINE_S

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "swarm": set(),
    "kernels": {"swarm"},
    "agent": {"swarm", "kernels"},
    "leader": {"swarm", "kernels"},
    "channel": {"swarm"},
    "worldsim": {"swarm", "kernels", "channel"},  # world and channel are one emulator process
    "groundstation": {"swarm", "kernels", "agent", "leader", "channel", "worldsim"},
}
MODULES = sorted(path for package in MAY_IMPORT for path in (ROOT / package).rglob("*.py"))
RERUN = {
    f"groundstation/{name}.py"
    for name in (
        *("recording", "recording_columns", "recording_map", "recording_links", "recording_events", "disturbances"),
        *("blueprint", "legend", "screenshot", "viewer", "recorded"),
    )
}
LEGACY_RANDOM = {"default_rng", "Generator", "SeedSequence", "BitGenerator", "PCG64"}  # the rest of np.random is global


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def imported(path: Path) -> set[str]:
    """Dotted names of every import in a module, wherever it stands."""
    names: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name_of(path)}:{node.lineno}: imports here are absolute"
            names.add(node.module or "")
    return names


def users_of(*libraries: str) -> set[str]:
    return {name_of(path) for path in MODULES if any(i.split(".")[0] in libraries for i in imported(path))}


def dotted(node: ast.AST) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def documentable(body: list[ast.stmt]) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    """Public functions and classes, and public methods of those classes."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and node.name[0] != "_":
            yield node
            if isinstance(node, ast.ClassDef):
                yield from documentable(node.body)


def promised() -> set[str]:
    """Methods a Protocol documents once for all who keep its promise."""
    return {
        method.name
        for path in MODULES
        for protocol in ast.walk(tree(path))
        if isinstance(protocol, ast.ClassDef) and any(dotted(base) == "Protocol" for base in protocol.bases)
        for method in documentable(protocol.body)
        if ast.get_docstring(method)
    }


def test_the_house_has_the_rooms_it_should_have() -> None:
    for package in MAY_IMPORT:
        assert (ROOT / package / "__init__.py").is_file()
    assert len(MODULES) > 30


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_flow_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    of_the_house = {name.split(".")[0] for name in imported(path)} & set(MAY_IMPORT)
    assert of_the_house - {package} <= MAY_IMPORT[package]


def test_nobody_outside_the_kernels_knows_which_form_runs() -> None:
    """But whoever compares them, or says so to a person."""
    asks = {
        name_of(path)
        for path in MODULES
        if {"meanflock.kernels.compiled", "meanflock.kernels.reference", "meanflock.kernels._native"} & imported(path)
        or "kernels.BACKEND" in path.read_text(encoding="utf-8")
    }
    assert asks == {"kernels/__init__.py", "kernels/compiled.py", "groundstation/doctor.py", "worldsim/summary.py"}


def test_one_file_imports_zenoh() -> None:
    assert users_of("zenoh") == {"swarm/net/session.py"}


def test_rerun_stays_with_the_recorder_and_what_it_shows() -> None:
    assert "groundstation/recording.py" in users_of("rerun", "rerun_sdk")
    assert users_of("rerun", "rerun_sdk") == RERUN


def test_one_file_sends_the_flight_to_rerun() -> None:
    senders = {name_of(path) for path in MODULES if "rr.send_columns(" in path.read_text(encoding="utf-8")}
    assert senders == {"groundstation/recording.py"}


def test_what_only_a_person_needs_stays_at_the_ground_station() -> None:
    users = users_of("click", "rich", "psutil", "pyarrow", "tomli_w", "joblib", "matplotlib")
    assert all(name.startswith("groundstation/") for name in users)
    assert all(name.startswith(("groundstation/", "channel/", "worldsim/")) for name in users_of("scipy"))


def test_one_file_talks_to_prometheus() -> None:
    assert users_of("prometheus_client") == {"worldsim/exporter.py"}


def test_no_clock_of_a_flight_can_be_set_by_anybody() -> None:
    """All durations and deadlines are of monotonic clocks; the wall clock names folders and dates certificates."""
    wall = {
        "time.time",
        "time.time_ns",
        "time.ctime",
        "time.localtime",
        "time.gmtime",
        "datetime.now",
        "datetime.utcnow",
    }
    wall |= {"datetime.today", "date.today", "datetime.datetime.now", "datetime.date.today"}
    readers = {
        name_of(path)
        for path in MODULES
        if any(isinstance(node, ast.Attribute) and dotted(node) in wall for node in ast.walk(tree(path)))
    }
    assert readers <= {f"groundstation/{name}.py" for name in ("run", "__main__", "certs", "doctor")}


LOADED = """
import sys
import {module}
print(*sorted({{name.split(".")[0] for name in sys.modules}} & set({forbidden!r})))
"""


@pytest.mark.parametrize(
    "module", ["meanflock.agent.__main__", "meanflock.leader.__main__", "meanflock.worldsim.__main__"]
)
def test_a_process_of_the_swarm_loads_only_what_it_needs(module: str) -> None:
    forbidden = ["rerun", "rerun_bindings", "pyarrow", "click", "rich", "psutil", "pandas", "hypothesis"]
    forbidden += ["groundstation", "joblib", "matplotlib", "pickletools", "prometheus_client"]
    if module != "meanflock.worldsim.__main__":
        forbidden += ["scipy", "channel", "worldsim"]
    code = LOADED.format(module=module, forbidden=forbidden)
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=DEADLINE_S, check=True
    )
    assert loaded.stdout.strip() == ""


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_is_short_enough_to_read(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_nothing_is_pickled_evaluated_or_drawn_from_a_global_generator(path: Path) -> None:
    libraries = {name.split(".")[0] for name in imported(path)}
    assert not libraries & {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "random"}
    for node in ast.walk(tree(path)):
        where = f"{name_of(path)}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Attribute):
            full = dotted(node)
            if full.startswith(("np.random.", "numpy.random.")):
                assert full.split(".")[2] in LEGACY_RANDOM, where
        if isinstance(node, ast.ImportFrom) and node.module == "numpy.random":
            assert {alias.name for alias in node.names} <= LEGACY_RANDOM, where
        if isinstance(node, ast.Call):
            assert dotted(node.func) not in {"eval", "exec"}, where
            assert all(keyword.arg != "allow_pickle" for keyword in node.keywords), where


def test_what_flies_makes_its_generators_in_one_place_only() -> None:
    makers = {
        name_of(path)
        for path in MODULES
        if not name_of(path).startswith("groundstation/")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call) and dotted(node.func).endswith("default_rng")
    }
    assert makers == {"swarm/seeds.py"}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_what_is_public_is_documented(path: Path) -> None:
    assert ast.get_docstring(tree(path)), f"{name_of(path)} says not what it is"
    silent = [
        f"{name_of(path)}:{node.lineno} {node.name}"
        for node in documentable(tree(path).body)
        if not ast.get_docstring(node) and node.name not in promised()
    ]
    assert not silent
