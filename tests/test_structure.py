"""The structure of the code: imports go one way, and each library is imported in its place."""

import ast
import os
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from meanflock.groundstation.cli.completion import VARIABLE
from tests.commands import loaded
from tests.groundstation.conftest import QUICK
from tests.sources import (
    MODULES,
    NAMES,
    ROOMS,
    ROOT,
    dotted,
    imported,
    module_of,
    name_of,
    needed,
    nodes,
    room_of,
    text,
    users_of,
)

MAY_IMPORT = {  # of the other rooms; `kind` is the package meanflock itself
    "kernels": set(),
    "swarm": {"kernels"},
    "federation": {"swarm"},
    "agent": {"swarm", "kernels", "federation"},
    "leader": {"swarm", "kernels", "federation"},
    "channel": {"swarm", "kernels", "federation"},
    "worldsim": {"swarm", "kernels", "federation", "channel"},  # world and channel are one emulator process
}
MAY_IMPORT["groundstation"] = set(MAY_IMPORT)
MAY_IMPORT["studies"] = set(MAY_IMPORT)
MAY_IMPORT["meanflock"] = set(MAY_IMPORT)
MAY_IMPORT["reproduction"] = set(MAY_IMPORT)
MAY_IMPORT["cli"] = set(MAY_IMPORT)
WITHIN = {  # of the other folders of groundstation; what lies beside them may be imported by all
    "results": set(),
    "recording": {"results"},
    "plots": {"results"},
    "export": {"results"},
    "launch": {"results", "recording"},
    "bridge": {"results", "launch"},
    "cli": {"results", "recording", "plots", "export", "bridge", "launch"},
}


def test_imports_flow_one_way() -> None:
    for path in MODULES:
        room = room_of(module_of(path))
        others = {room_of(name) for name in needed(path)} - {room}
        assert others <= MAY_IMPORT[room], name_of(path)
        bare = {name.split(".")[0] for name in imported(path)} & set(ROOMS)
        assert not bare, f"{name_of(path)}: rooms are imported as meanflock.<room>"


def test_imports_within_the_ground_station_flow_one_way() -> None:
    ground = ROOT / "groundstation"
    for path in (path for path in MODULES if path.parent.parent == ground):
        folders = {NAMES[name].parent for name in needed(path)} - {path.parent}
        assert {folder.name for folder in folders if folder.parent == ground} <= WITHIN[path.parent.name], name_of(path)


def test_no_module_imports_itself_by_way_of_others() -> None:
    """Imports for the type checker count, and so do those within a function; packages count as their `__init__`."""
    TopologicalSorter({name: needed(path) for name, path in NAMES.items()}).prepare()  # a CycleError names the circle


def test_no_other_room_knows_whether_compiled_kernels_run() -> None:
    """But whoever compares them, or says so to a person."""
    asks = {
        name_of(path)
        for path in MODULES
        if {"meanflock.kernels.compiled", "meanflock.kernels.reference", "meanflock.kernels._native"} & imported(path)
        or "kernels.BACKEND" in text(path)
    }
    assert asks == {"kernels/__init__.py", "kernels/compiled.py", "groundstation/doctor.py", "worldsim/summary.py"}


def test_only_the_mean_field_methods_read_their_tables_and_call_their_kernels() -> None:
    """Except that swarm/ defines the tables, kernels/ chooses a form, and the study of the paper reads both."""
    theirs = ("agent/controllers/mean_field/", "kernels/", "swarm/scenario/", "reproduction/")
    table = re.compile(r"scenario\.(cost|learner|density|offline)$")
    packages = ("meanflock.kernels.mean_field", "meanflock.swarm.scenario.mean_field")
    for path in MODULES:
        reads = {dotted(node) for node in nodes(path) if isinstance(node, ast.Attribute) and table.search(dotted(node))}
        reads |= {name for name in needed(path) if name.startswith(packages)}
        assert not reads or name_of(path).startswith(theirs), f"{name_of(path)} reads {reads}"


GROUND = ("groundstation/", "studies/", "meanflock/", "reproduction/")


@pytest.mark.parametrize(
    ("libraries", "users"),
    [
        (("zenoh",), ("swarm/net/session.py",)),
        (("prometheus_client",), ("worldsim/exporter.py",)),
        (("rerun", "rerun_sdk"), ("groundstation/recording/",)),
        (("click", "rich", "psutil", "pyarrow", "matplotlib"), GROUND),
        (
            ("foxglove_schemas_protobuf", "google", "mcap", "mcap_protobuf", "rosbags"),
            tuple(f"groundstation/export/{name}.py" for name in ("columns", "foxglove", "rosbag")),
        ),
        (("pymavlink",), ("swarm/wire/mavlink.py",)),
        (("tomli_w",), (*GROUND, "swarm/scenario/values.py")),
        (("scipy",), GROUND),
        (("gymnasium", "pettingzoo"), ("meanflock/env/",)),
    ],
    ids=lambda names: names[0],
)
def test_a_library_is_imported_only_where_it_belongs(libraries: tuple[str, ...], users: tuple[str, ...]) -> None:
    found = users_of(*libraries)
    assert found
    assert all(name.startswith(users) for name in found)


def test_only_files_of_people_read_the_wall_clock() -> None:
    """All durations and deadlines are of monotonic clocks; the wall clock names folders and dates certificates."""
    wall = {f"time.{name}" for name in ("time", "time_ns", "ctime", "localtime", "gmtime")}
    wall |= {f"datetime.{name}" for name in ("now", "utcnow", "today", "datetime.now", "date.today")} | {"date.today"}
    readers = {
        name_of(path)
        for path in MODULES
        if any(isinstance(node, ast.Attribute) and dotted(node) in wall for node in nodes(path))
    }
    assert readers <= {f"groundstation/{name}.py" for name in ("launch/run", "__main__", "certs", "doctor")}


HEAVY = ["rerun", "rerun_bindings", "pyarrow", "click", "rich", "psutil", "pandas", "hypothesis", "matplotlib"]
HEAVY += ["meanflock.groundstation", "meanflock.studies", "pickletools", "prometheus_client", "scipy"]
SCIENCE = [*HEAVY, "meanflock.channel", "meanflock.worldsim"]
DRAWING = ["rerun", "rerun_bindings", "matplotlib"]
FLYING = [*DRAWING, "numpy", "pyarrow", "rich", "psutil", "zenoh"]
DRAW_NOTHING = "import random; random.seed(1); before = random.getstate(); import meanflock as mf; mf.compare\n"


def called(*arguments: str) -> str:
    """Code that calls the command."""
    return f"from meanflock.groundstation.cli.command import main\nassert main({list(arguments) or None}) == 0"


def completed(line: str) -> str:
    """Code that completes the last word of a line, as Bash has it done."""
    asked = {VARIABLE: "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    return f"import os\nos.environ.update({asked})\n{called()}"


@pytest.mark.parametrize(
    ("code", "forbidden"),
    [
        ("import meanflock.agent.__main__, meanflock.leader.__main__", SCIENCE),
        ("import meanflock.worldsim.__main__", HEAVY),
        (  # statistics take a second of the start of each worker and command
            "import meanflock.studies.study, reproduction.experiments, meanflock.studies.means",
            ["scipy.stats", "matplotlib", "rerun"],
        ),
        (f"{DRAW_NOTHING}assert random.getstate() == before", ["matplotlib", "rich", "rerun", "click"]),
        (called("--help"), [*FLYING, "meanflock.groundstation.cli.fly"]),
        (called("run", "--help"), FLYING),
        (
            called(*QUICK, "--json"),
            [*DRAWING, "zenoh", "pyarrow.compute", "cryptography", "prometheus_client", "scipy"],
        ),
        *(
            (completed(f"meanflock {line}"), [*FLYING, "msgspec", "meanflock.agent.controllers"])
            for line in (
                "run --method plan",
                "run --set radio.model=i",
                "run --set controller.sp",
                "sweep uavs",
                "show r",
            )
        ),
    ],
)
def test_a_process_loads_only_what_it_needs(code: str, forbidden: list[str], tmp_path: Path) -> None:
    path = os.environ | {"PYTHONPATH": str(ROOT)}
    assert loaded(code, cwd=tmp_path, env=path) & set(forbidden) == set()


def test_nothing_is_pickled_evaluated_or_drawn_from_a_global_generator() -> None:
    """The linter looks for NumPy's global generator."""
    for path in MODULES:
        libraries = {name.split(".")[0] for name in imported(path)}
        # One seeds the global generators to find out who draws from them, and puts them back.
        seeds_them = name_of(path) == "meanflock/testing/error.py"
        forbidden = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "random"}
        assert not libraries & (forbidden - ({"random"} if seeds_them else set())), name_of(path)
        for node in nodes(path):
            where = f"{name_of(path)}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Call):
                assert dotted(node.func) not in {"eval", "exec"}, where
                assert all(keyword.arg != "allow_pickle" for keyword in node.keywords), where


def test_one_file_makes_the_random_generators_of_a_flight() -> None:
    makers = {
        name_of(path)
        for path in MODULES
        if not name_of(path).startswith(("studies/", "meanflock/testing/", "reproduction/"))
        for node in nodes(path)
        if isinstance(node, ast.Call) and dotted(node.func).endswith("default_rng")
    }
    assert makers == {"swarm/seeds.py"}
