"""Flower apps for tests: copies of examples/flower_app, some with other files; and what comes of them in flight."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from sklearn.datasets import load_digits

from tests.commands import COMMAND, ended
from tests.sources import ROOT

VARIANTS = ROOT / "tests" / "flower_apps"
IDEAL = "radio.model=ideal"
OURS = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}

MAIN = '''"""A ServerApp for a test."""

import time

import numpy as np
from flwr.app import Array, ArrayRecord, ConfigRecord, Message, RecordDict
from flwr.serverapp import ServerApp

from flower_digits import task

app = ServerApp()


def messages(grid, kind="train", scale=lambda place: 1.0, **more):
    """Returns a message to each node, with a model times a number."""
    found = []
    for place, node in enumerate(grid.get_node_ids()):
        model = {name: Array((scale(place) * array).astype(np.float32)) for name, array in task.new_model().items()}
        content = {"arrays": ArrayRecord(model), "config": ConfigRecord({"server-round": 1})}
        found.append(Message(RecordDict(content | more), node, kind))
    return found


@app.main()
def main(grid, context):
'''


STORED = """
from pathlib import Path


def load_digits(return_X_y):
    with np.load(Path(__file__).with_name("digits.npz")) as stored:
        return stored["images"], stored["labels"]
"""


class Flown(NamedTuple):
    """What came of a flight: exit code, standard error, `result.json`, and what the app saved."""

    code: int
    said: str
    result: dict[str, Any]
    saved: dict[str, Any]

    @property
    def bits(self) -> tuple[Any, ...]:
        """All that must be equal in every mode."""
        summary = self.result["summary"]
        return summary["trajectory_sha256"], summary["models_sha256"], summary["payload_bits"], self.result["rounds"]


def build(folder: Path, variant: str = "", main: str = "", *, as_shipped: bool = False) -> Path:
    """Make an app in a folder: the example, its files replaced by those of a variant, its ServerApp by a function.

    Unless it is `as_shipped`, it reads its pictures from a file: each process would take a second to import sklearn.
    """
    app = folder / (variant or "app")
    shutil.copytree(ROOT / "examples" / "flower_app", app, ignore=shutil.ignore_patterns("__pycache__"))
    if not as_shipped:
        images, labels = load_digits(return_X_y=True)
        np.savez(app / "flower_digits" / "digits.npz", images=images, labels=labels)
        task = app / "flower_digits" / "task.py"
        importing = "from sklearn.datasets import load_digits\n"
        code = task.read_text()
        assert importing in code
        task.write_text(code.replace(importing, STORED))
    if variant:
        shutil.copytree(VARIANTS / variant, app / "flower_digits", dirs_exist_ok=True)
    if main:
        (app / "flower_digits" / "server_app.py").write_text(MAIN + main)
    return app


def fly(app: Path, *flags: object, uavs: int = 10, settings: tuple[str, ...] = (), **config: Any) -> Flown:
    """Fly an app by the command."""
    out = app.parent / f"{app.name}-runs-{len(list(app.parent.glob('*-runs-*')))}"
    saved = out.with_suffix(".npz")
    pairs = " ".join(
        f"{name.replace('_', '-')}={_toml(value)}" for name, value in (config | {"save_to": str(saved)}).items()
    )
    given = [part for one in settings for part in ("--set", one)]
    done = ended(
        *COMMAND,
        "flower",
        app,
        "--uavs",
        uavs,
        "--out",
        out,
        "--quiet",
        "--run-config",
        pairs,
        *given,
        *flags,
        env=OURS,
    )
    results = list(out.glob("2*/result.json"))
    result = json.loads(results[0].read_text()) if results else {}
    return Flown(done.returncode, done.stderr, result, _arrays(saved))


def in_engine(app: Path, configs: list[dict[str, Any]], folder: Path) -> list[dict[str, Any]]:
    """What an app saves in Flower's own simulation engine, with ten nodes, for each of some configurations."""
    wanted = [config | {"save-to": str(folder / f"{number}.npz")} for number, config in enumerate(configs)]
    script = Path(__file__).with_name("flower_engine.py")
    command = [sys.executable, str(script), str(app), json.dumps(wanted)]
    for left in (2, 1, 0):  # Flower's engine sometimes waits for ever for a ray that did not start; it takes a minute
        try:
            with tempfile.TemporaryDirectory(dir="/tmp") as short:  # Ray's sockets have paths of 107 bytes at most
                env = os.environ | {"TMPDIR": short}
                done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False, env=env)
            break
        except subprocess.TimeoutExpired:
            if not left:
                raise
    assert done.returncode == 0, done.stderr[-3000:]
    return [_arrays(Path(config["save-to"])) for config in wanted]


def _arrays(file: Path) -> dict[str, Any]:
    if not file.exists():
        return {}
    with np.load(file) as saved:
        return dict(saved)


def _toml(value: Any) -> str:
    return f"'{value}'" if isinstance(value, str) else json.dumps(value)
