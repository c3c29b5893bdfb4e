"""Stable-Baselines3 trains in our environment, and its actor flies as a policy of meanflock."""

import json
import os
import sysconfig
from pathlib import Path

import meanflock as mf
from meanflock import env
from tests.commands import printed
from tests.sources import ROOT

SCRIPT = Path(__file__).with_name("sb3_trains.py")
JUDGE = "sb3"
STEPS = 5 * 512  # one update


def test_the_actor_of_ppo_acts_the_same_as_a_saved_policy_and_flies(python: Path, tmp_path: Path) -> None:
    file = tmp_path / "ppo.npz"
    ours = os.pathsep.join([str(ROOT), sysconfig.get_path("purelib")])  # meanflock, and the libraries of its extra `rl`
    said = printed(python, SCRIPT, ROOT / "examples", file, STEPS, env=os.environ | {"PYTHONPATH": ours})
    told = json.loads(said.splitlines()[-1])
    policy = env.policy(file)
    assert (told["sha256"], told["steps"]) == (policy.sha256, STEPS)
    assert told["error"] < 1e-5  # m/s²: the actor computes in float32
    run = mf.fly("paper", uavs=5, duration=10, seed=7, **policy.keys)
    assert (run.summary["ticks"], run.summary["lost"]) == (100, 0)
