"""Trains a policy for all UAVs by the cross-entropy method, and saves it: `python examples/train.py out/policy.npz`.

Five numbers are searched: the pull to the goal, the damping, the push away from the nearest UAV, and the constant
acceleration along x and y that the wind asks for. Each candidate flies one flight; the best quarter decides where the
next candidates are drawn.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import meanflock.env as env

NEIGHBOURS = 2
ACCELERATION = 3.0  # largest along an axis, m/s²
CANDIDATES, BEST, GENERATIONS = 12, 3, 8
MEAN = np.array([0.0, 0.0, 0.0, 0.0, 0.0])  # knows nothing: it does not even fly to its goal
DEVIATION = np.array([0.1, 0.5, 0.1, 0.2, 0.2])


def layers(numbers):
    """One layer of weights and biases; x and y are treated alike."""
    pull, damping, push, *constant = numbers
    weights = np.zeros((4 + 6 * NEIGHBOURS, 2))
    for axis in (0, 1):
        weights[axis, axis] = -pull  # own position minus the goal
        weights[2 + axis, axis] = -damping
        weights[4 + axis, axis] = -push  # position of the nearest UAV minus one's own
    return [(weights, np.array(constant))]


def flown(flights, numbers, seed, file):
    """The mean reward of a UAV in flights that begin with a seed, and their summaries."""
    policy = env.save_policy(file, layers(numbers), neighbours=NEIGHBOURS, acceleration=ACCELERATION)
    observations, _ = flights.reset(seed=seed)
    flights.summaries.clear()
    total, ended = 0.0, np.zeros(flights.num_envs, dtype=bool)
    while not ended.all():
        observations, rewards, terminated, truncated, _ = flights.step(policy(observations))
        total += float(rewards[~ended].sum())
        ended |= terminated | truncated
    return total / flights.num_envs, list(flights.summaries)


def train(file, mission, uavs):
    """Searches the numbers on the seeds from 1 on, and saves the best mean."""
    rng = np.random.default_rng(1)
    flights = env.vector_env(mission, flights=1, neighbours=NEIGHBOURS, uavs=uavs, duration=60.0)
    mean, deviation = MEAN, DEVIATION
    for generation in range(1, GENERATIONS + 1):
        candidates = mean + deviation * rng.standard_normal((CANDIDATES, len(mean)))
        rewards = [flown(flights, numbers, generation, file)[0] for numbers in candidates]
        best = candidates[np.argsort(rewards)[-BEST:]]
        mean, deviation = best.mean(axis=0), best.std(axis=0) + 0.02 * DEVIATION
        print(f"generation {generation}: best reward {max(rewards):.0f}, {time.process_time():.0f} s CPU", flush=True)
    return env.save_policy(file, layers(mean), neighbours=NEIGHBOURS, acceleration=ACCELERATION), mean


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--mission", default="paper")
    parser.add_argument("--uavs", type=int, default=9, help="in training; the policy flies any number")
    given = parser.parse_args()
    policy, mean = train(given.file, given.mission, given.uavs)
    print(f"{policy.path}: {', '.join(f'{number:.3f}' for number in mean)}")
    others = env.vector_env(given.mission, flights=2, neighbours=NEIGHBOURS)
    _, summaries = flown(others, mean, 1001, given.file)
    arrived, all_uavs = (sum(summary[key] for summary in summaries) for key in ("arrived", "uavs"))
    print(f"on seeds that it was not trained on, {arrived} of {all_uavs} UAVs arrive")
