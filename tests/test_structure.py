"""The structure of the code: imports go one way, and each library is imported in its place."""

import ast
import os
import re
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from meanflock.groundstation.cli.completion import VARIABLE
from tests.commands import loaded, printed
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
)

MAY_IMPORT: dict[str, set[str]] = {  # of the other rooms; `meanflock` is the package itself
    "kernels": set(),
    "swarm": {"kernels"},
    "federation": {"swarm"},
    "agent": {"swarm", "kernels", "federation"},
    "leader": {"swarm", "kernels", "federation"},
    "channel": {"swarm", "kernels", "federation"},
    # World and channel are one process, and agents and leader may be in it, too.
    "worldsim": {"swarm", "kernels", "federation", "channel", "agent", "leader"},
}
for room in ("groundstation", "studies", "meanflock", "reproduction", "cli"):  # each may import all before it
    MAY_IMPORT[room] = set(MAY_IMPORT)


def test_imports_flow_one_way() -> None:
    for path in MODULES:
        room = room_of(module_of(path))
        others = {room_of(name) for name in needed(path)} - {room}
        assert others <= MAY_IMPORT[room], name_of(path)
        bare = {name.split(".")[0] for name in imported(path)} & set(ROOMS)
        assert not bare, f"{name_of(path)}: rooms are imported as meanflock.<room>"


def test_no_module_imports_itself_by_way_of_others() -> None:
    """Imports for the type checker count, and so do those within a function; packages count as their `__init__`."""
    TopologicalSorter({name: needed(path) for name, path in NAMES.items()}).prepare()  # a CycleError names the circle


GROUND = ("groundstation/", "studies/", "meanflock/", "reproduction/")


@pytest.mark.parametrize(
    ("libraries", "users"),
    [
        (("zenoh",), ("swarm/net/session.py",)),
        (("prometheus_client",), ("worldsim/exporter.py",)),
        (("rerun", "rerun_sdk"), ("groundstation/recording/",)),
        (("click", "rich", "psutil", "pyarrow", "matplotlib"), GROUND),
        (("mcap", "rosbags"), ("groundstation/export/bag.py", "groundstation/export/messages.py")),
        (("pymavlink",), ("swarm/wire/mavlink.py",)),
        (("tomli_w",), (*GROUND, "swarm/scenario/values.py")),
        (("scipy",), GROUND),
        (("gymnasium", "pettingzoo"), ("meanflock/env/",)),
        (("pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve"), ()),
        (("random",), ("meanflock/testing/error.py",)),  # it seeds the generator to find out who draws from it
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
        (r"meanflock\.kernels\.(compiled|reference|_native)", ("kernels/", "groundstation/doctor.py")),
        (
            r"meanflock\.(kernels\.mean_field|swarm\.scenario\.mean_field).*",
            ("agent/controllers/mean_field/", "kernels/", "swarm/scenario/", "reproduction/"),
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
        tuple(f"groundstation/{name}.py" for name in ("launch/run", "__main__", "certs", "doctor")),
    ),
    (r".*default_rng", ("swarm/seeds.py", "studies/", "meanflock/testing/", "reproduction/")),
    (r"eval|exec", ()),
    (r"np\.load", ("agent/controllers/policy/network.py",)),  # that it unpickles nothing: tests/door/test_env.py
    (r"kernels\.BACKEND", ("groundstation/doctor.py", "worldsim/summary.py")),
    (  # the tables of the mean-field methods
        r".*scenario\.(cost|learner|density|offline)",
        ("agent/controllers/mean_field/", "kernels/", "swarm/scenario/", "reproduction/"),
    ),
]


@pytest.mark.parametrize(("pattern", "users"), ONLY)
def test_a_name_is_used_only_where_it_belongs(pattern: str, users: tuple[str, ...]) -> None:
    for path in MODULES:
        used = [node for node in nodes(path) if isinstance(node, ast.Attribute | ast.Name)]
        found = {dotted(node) for node in used if re.fullmatch(pattern, dotted(node))}
        assert not found or name_of(path).startswith(users), f"{name_of(path)}: {found}"


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


WATCH = """
import os, sys

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[name] = "4"
threads = lambda: print(os.environ.get("OPENBLAS_NUM_THREADS"), os.environ.get("OMP_NUM_THREADS"))
sys.addaudithook(lambda event, about: threads() if (event, about[0]) == ("import", "numpy") else None)
import meanflock.groundstation.cli.__main__, numpy
"""


def test_every_process_limits_blas_to_one_thread_before_it_imports_numpy() -> None:
    for room in ("groundstation/cli", "agent", "leader", "worldsim", "groundstation"):
        names = re.findall(r"^\s*(?:import|from) (meanflock\S*|numpy)", text(ROOT / room / "__main__.py"), re.MULTILINE)
        assert names[0] == "meanflock.swarm.one_thread", room
    assert printed(sys.executable, "-c", WATCH).strip() == "1 1"
