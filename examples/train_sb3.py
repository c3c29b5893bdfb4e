"""Trains a policy by PPO of Stable-Baselines3, and flies its actor: `python examples/train_sb3.py out/ppo.npz`.

Install it beside the extra `rl`: `pip install 'meanflock[rl]' stable-baselines3`.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import meanflock as mf
import meanflock.env as env

NEIGHBOURS = 2
ACCELERATION = 3.0  # largest along an axis, m/s²
SCALE = np.array([50.0, 50.0, 10.0, 10.0] + NEIGHBOURS * [5.0, 5.0, 5.0, 5.0, 1.0, 1.0])  # of an observation
REWARD_SCALE = 0.1  # the values of states are then near 1, which the critic learns sooner


class Rows(VecEnv):
    """The rows of one flight as Stable-Baselines3 wants them: a flight that is over begins anew in the same step.

    `set_attr` and `env_method` are abstract there, and PPO calls neither.

    An action is a number before tanh, because the action of a saved policy is `acceleration * tanh(…)`.
    """

    def __init__(self, mission, uavs, seed):
        self.flight = env.vector_env(mission, flights=1, neighbours=NEIGHBOURS, uavs=uavs, seed=seed, duration=60.0)
        observations = self.flight.single_observation_space
        super().__init__(uavs, Box(-np.inf, np.inf, observations.shape), Box(-10.0, 10.0, (2,)))

    def reset(self):
        return self._scaled(self.flight.reset()[0])

    def step_async(self, actions):
        self.actions = ACCELERATION * np.tanh(actions)

    def step_wait(self):
        rows, rewards, terminated, truncated, flown = self.flight.step(self.actions.astype(np.float64))
        observations, ended = self._scaled(rows), terminated | truncated
        infos = [{} for _ in rows]
        if (ended | ~flown["active"]).all():  # the flight is over; rows of lost UAVs ended before
            ended[:] = True
            for info, last, stopped in zip(infos, observations, truncated, strict=True):
                info |= {"terminal_observation": last, "TimeLimit.truncated": bool(stopped)}
            observations = self._scaled(self.flight.step(np.zeros_like(self.actions, dtype=np.float64))[0])
        return observations, REWARD_SCALE * rewards.astype(np.float32), ended, infos

    def _scaled(self, rows):
        return (rows / SCALE).astype(np.float32)

    def close(self):
        self.flight.close()

    def get_attr(self, name, indices=None):
        return [getattr(self.flight, name, None) for _ in self._get_indices(indices)]

    def set_attr(self, name, value, indices=None):
        raise NotImplementedError

    def env_method(self, name, *arguments, indices=None, **options):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper, indices=None):
        return [False for _ in self._get_indices(indices)]


def train(mission="paper", uavs=9, steps=400_000, seed=1):
    """A learner of PPO after so many steps of a UAV."""
    torch.set_num_threads(1)
    network = {"net_arch": [32, 32], "activation_fn": torch.nn.Tanh, "log_std_init": -1.0}
    rows = Rows(mission, uavs, seed)
    learner = PPO("MlpPolicy", rows, policy_kwargs=network, n_steps=512, batch_size=512, seed=seed, device="cpu")
    return learner.learn(steps)


def save(learner, file):
    """The actor of a learner as a policy of meanflock: the weights of its layers, transposed."""
    actor = [*learner.policy.mlp_extractor.policy_net, learner.policy.action_net]
    layers = [
        (layer.weight.detach().numpy().T, layer.bias.detach().numpy())
        for layer in actor
        if isinstance(layer, torch.nn.Linear)
    ]
    return env.save_policy(file, layers, neighbours=NEIGHBOURS, acceleration=ACCELERATION, scale=SCALE)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--steps", type=int, default=400_000, help="of a UAV")
    given = parser.parse_args()
    policy = save(train(steps=given.steps), given.file)
    run = mf.fly("paper", seed=1001, **policy.keys)
    print(f"{policy.path}: {run.summary['arrived']} of {run.summary['uavs']} UAVs arrive on a seed of no training")
