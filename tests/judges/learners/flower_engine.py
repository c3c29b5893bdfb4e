"""Run a Flower app in Flower's own simulation engine: `flower_engine.py APP_DIR CONFIGS`, a JSON list.

Ten nodes, for each configuration a run; `override_config` is what `flwr run --run-config` sets.
"""

import importlib
import json
import os
import sys
import tomllib
from pathlib import Path

os.environ |= {"FLWR_TELEMETRY_ENABLED": "0", "RAY_USAGE_STATS_ENABLED": "0", "PYTHONPATH": sys.argv[1]}
sys.path.insert(0, sys.argv[1])

import ray
from flwr.app import Context, RecordDict
from flwr.common import EventType
from flwr.simulation.run_simulation import _run_simulation
from flwr.supercore.constant import NOOP_FEDERATION_ID
from flwr.supercore.run import Run
from flwr.supercore.task_identity import TaskIdentity

NODES = 10
APP = tomllib.loads((Path(sys.argv[1]) / "pyproject.toml").read_text())["tool"]["flwr"]["app"]


def component(key: str) -> object:
    """A component of the app."""
    module, _, name = APP["components"][key].partition(":")
    return getattr(importlib.import_module(module), name)


# A run takes a Ray that is there, and shuts it down: a start takes longer than a run.
ray.init(num_cpus=1, log_to_driver=False, object_store_memory=100_000_000, include_dashboard=False)
ray.shutdown = lambda: None
TaskIdentity.task_id = TaskIdentity.run_id = TaskIdentity.node_id = 1
for config in json.loads(sys.argv[2]):
    whole = APP["config"] | config
    run = Run.create_empty(1)
    run.primary_task_id, run.federation_id, run.override_config = 1, NOOP_FEDERATION_ID, whole
    _run_simulation(
        NODES,
        EventType.PYTHON_API_RUN_SIMULATION_LEAVE,
        client_app=component("clientapp"),
        server_app=component("serverapp"),
        is_app=True,
        app_dir=sys.argv[1],
        server_app_context=Context(1, 0, {}, RecordDict(), whole),
        run=run,
        backend_config={"client_resources": {"num_cpus": 1, "num_gpus": 0.0}},
    )
