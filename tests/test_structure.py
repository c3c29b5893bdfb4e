"""The structure of the code: imports go one way, and each library is imported in its place."""

import ast
import os
import re
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from meanflock.cli.completion import VARIABLE
from tests.commands import loaded, printed
from tests.groundstation.conftest import QUICK
from tests.sources import (
    DOOR,
    MODULES,
    NAMES,
    ROOMS,
    ROOT,
    imported,
    module_of,
    name_of,
    needed,
    nodes,
    room_of,
    text,
    used,
)

# From the lowest up; a room may import those below its row. `meanflock` is the Python API; programs are the launcher's.
ROWS: tuple[tuple[str, ...], ...] = (
    ("kernels",),
    ("swarm",),
    ("federation",),
    ("agent", "channel", "leader"),
    ("flower", "worldsim"),
    ("net", "results"),
    ("bridge", "export", "recording"),
    ("launch", "groundstation"),
    ("studies",),
    ("meanflock",),
    ("research",),
    ("cli",),
)
ABOVE = {room: {other for row in ROWS[k:] for other in row} - {room} for k, row in enumerate(ROWS) for room in row}


def test_imports_flow_one_way() -> None:
    assert {*ROOMS, "meanflock", "research"} == set(ABOVE)
    for path in MODULES:
        room = room_of(module_of(path))
        assert not {room_of(name) for name in needed(path)} & ABOVE[room], name_of(path)
        bare = {name.split(".")[0] for name in imported(path)} & set(ROOMS)
        assert not bare, f"{name_of(path)}: rooms are imported as meanflock.<room>"


BLOCKED = """
import importlib, sys
from importlib.abc import MetaPathFinder

class Wall(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.startswith({above!r}):
            raise ImportError(f"{{name}} is above")

sys.meta_path.insert(0, Wall())
for name in {modules!r}:
    importlib.import_module(name)
"""


WITH_LIBRARIES = {"flower", "groundstation"}  # that are not here: Flower; or load much


@pytest.mark.parametrize("room", sorted(set(ROOMS) - WITH_LIBRARIES))
def test_a_room_can_be_imported_where_the_rooms_above_it_are_not(room: str) -> None:
    above = ("research", *(f"meanflock.{name}" for name in ABOVE[room] & set(ROOMS)))
    modules = [name for name, path in NAMES.items() if room_of(name) == room and path.name != "__main__.py"]
    printed(
        sys.executable, "-c", BLOCKED.format(above=above, modules=modules), env=os.environ | {"PYTHONPATH": str(ROOT)}
    )


def test_no_module_imports_itself_by_way_of_others() -> None:
    """Imports for the type checker count, and so do those within a function; packages count as their `__init__`."""
    TopologicalSorter({name: needed(path) for name, path in NAMES.items()}).prepare()  # a CycleError names the circle


def test_a_noun_is_one_class() -> None:
    """The options of a plug-in are its class `Options`, wherever it is."""
    found: dict[str, list[str]] = {}
    for path in MODULES:
        for node in nodes(path):
            if isinstance(node, ast.ClassDef) and node.name != "Options":
                found.setdefault(node.name.lstrip("_"), []).append(name_of(path))
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


GROUND = (  # where a person stands
    *map(name_of, DOOR),
    "research/",
    *(f"meanflock/{room}/" for room in ("cli", "export", "groundstation", "launch", "recording", "results", "studies")),
)


@pytest.mark.parametrize(
    ("libraries", "users"),
    [
        (("zenoh",), ("meanflock/net/session.py",)),
        (("prometheus_client",), ("meanflock/net/exporter.py",)),
        (("rerun", "rerun_sdk"), ("meanflock/recording/",)),
        (("click", "rich", "psutil", "matplotlib"), GROUND),
        (("pyarrow",), (*GROUND, "worldsim/vehicles/tracks.py")),
        (("mcap", "rosbags"), ("meanflock/export/bag.py", "meanflock/export/messages.py")),
        (("pymavlink",), ("meanflock/bridge/mavlink.py",)),
        (("tomli_w",), (*GROUND, "meanflock/swarm/scenario/values.py")),
        (("scipy",), GROUND),
        (("gymnasium", "pettingzoo"), ("meanflock/env/",)),
        (("pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve"), ()),
        # They seed the generator: to find out who draws from it, and for a learner that does.
        (("random",), ("meanflock/swarm/global_generators.py",)),
    ],
    ids=lambda names: names[0] if names else "nowhere",
)
def test_a_library_is_imported_only_where_it_belongs(libraries: tuple[str, ...], users: tuple[str, ...]) -> None:
    found = {name_of(path) for path in MODULES if any(i.split(".")[0] in libraries for i in imported(path))}
    assert bool(found) == bool(users)
    assert all(name.startswith(users) for name in found)


@pytest.mark.parametrize(
    ("modules", "users"),
    [
        (
            r"meanflock\.kernels\.(compiled|reference|_native)",
            ("meanflock/kernels/", "meanflock/launch/doctor.py"),
        ),
        (
            r"meanflock\.(kernels\.mean_field|swarm\.scenario\.mean_field).*",
            (
                "agent/controllers/mean_field/",
                "meanflock/kernels/",
                "meanflock/swarm/scenario/",
                "research/",
            ),
        ),
    ],
)
def test_a_module_of_ours_is_imported_only_where_it_belongs(modules: str, users: tuple[str, ...]) -> None:
    for path in MODULES:
        found = [name for name in imported(path) | needed(path) if re.fullmatch(modules, name)]
        assert not found or name_of(path).startswith(users), f"{name_of(path)}: {found}"


# A pattern of what is called or read, and where alone it may be.
ONLY = [
    (  # all durations and deadlines are of monotonic clocks; the wall clock names folders and dates certificates
        r"time\.(time|time_ns|ctime|localtime|gmtime)|(datetime\.)?(datetime\.(now|utcnow|today)|date\.today)",
        tuple(
            f"meanflock/{name}.py" for name in ("launch/run", "groundstation/__main__", "launch/certs", "launch/doctor")
        ),
    ),
    (
        r".*default_rng",
        ("meanflock/swarm/seeds.py", "meanflock/studies/", "meanflock/testing/", "research/"),
    ),
    (r"eval|exec", ()),
    (r"np\.load", ("agent/controllers/policy/network.py",)),  # that it unpickles nothing: tests/door/test_env.py
    (r"kernels\.BACKEND", ("meanflock/launch/doctor.py", "meanflock/studies/study_file.py", "worldsim/summary.py")),
    (  # the tables of the mean-field methods
        r".*scenario\.(cost|learner|density|offline)",
        ("agent/controllers/mean_field/", "meanflock/kernels/", "meanflock/swarm/scenario/", "research/"),
    ),
]


@pytest.mark.parametrize(("pattern", "users"), ONLY)
def test_a_name_is_used_only_where_it_belongs(pattern: str, users: tuple[str, ...]) -> None:
    for path in MODULES:
        found = {name for name in used(path) if re.fullmatch(pattern, name)}
        assert not found or name_of(path).startswith(users), f"{name_of(path)}: {found}"


HEAVY = ["rerun", "rerun_bindings", "pyarrow", "click", "rich", "psutil", "pandas", "hypothesis", "matplotlib"]
HEAVY += [f"meanflock.{room}" for room in ("cli", "export", "groundstation", "recording", "results", "studies")]
HEAVY += ["pickletools", "prometheus_client", "scipy"]
SCIENCE = [*HEAVY, "meanflock.channel", "meanflock.worldsim"]
DRAWING = ["rerun", "rerun_bindings", "matplotlib"]
FLYING = [*DRAWING, "numpy", "pyarrow", "rich", "psutil", "zenoh"]
PURE = """from meanflock.swarm.scenario import Scenario
Scenario(method="orca", uavs=9, **{"federation.topology": "clusters", "filter.kind": "ecbf"}).replace(seed=2)"""
DRAW_NOTHING = "import random; random.seed(1); before = random.getstate(); import meanflock as mf; mf.compare\n"


def called(*arguments: str) -> str:
    """Code that calls the command."""
    return f"from meanflock.cli.command import main\nassert main({list(arguments) or None}) == 0"


def completed(line: str) -> str:
    """Code that completes the last word of a line, as Bash has it done."""
    asked = {VARIABLE: "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    return f"import os\nos.environ.update({asked})\n{called()}"


@pytest.mark.parametrize(
    ("code", "forbidden"),
    [
        ("import meanflock.agent.__main__, meanflock.leader.__main__", SCIENCE),
        (PURE, [*SCIENCE, "meanflock.agent", "meanflock.federation"]),
        ("import meanflock.worldsim.__main__", HEAVY),
        (  # statistics take a second of the start of each worker and command
            "import meanflock.studies.study, research.reproduction.experiments, meanflock.studies.means",
            ["scipy.stats", "matplotlib", "rerun"],
        ),
        (f"{DRAW_NOTHING}assert random.getstate() == before", ["matplotlib", "rich", "rerun", "click"]),
        (called("--help"), [*FLYING, "meanflock.cli.fly"]),
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


WATCH = """
import os, sys

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[name] = "4"
threads = lambda: print(os.environ.get("OPENBLAS_NUM_THREADS"), os.environ.get("OMP_NUM_THREADS"))
sys.addaudithook(lambda event, about: threads() if (event, about[0]) == ("import", "numpy") else None)
import meanflock.cli.__main__, numpy
"""


def test_every_process_limits_blas_to_one_thread_before_it_imports_numpy() -> None:
    for room in ("cli", "agent", "leader", "worldsim", "groundstation"):
        names = re.findall(
            r"^\s*(?:import|from) (meanflock\S*|numpy)", text(ROOT / "meanflock" / room / "__main__.py"), re.MULTILINE
        )
        assert names[0] == "meanflock.swarm.one_thread", room
    assert printed(sys.executable, "-c", WATCH).strip() == "1 1"
