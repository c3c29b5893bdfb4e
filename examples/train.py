"""Trains a policy for all UAVs by the cross-entropy method, and saves it: `python examples/train.py out/policy.npz`.

Nine numbers are searched: speed, braking distance and damping, a constant acceleration along x and y against the wind,
and four of the push away from the nearest UAVs. Each candidate flies one flight of each mission; the best quarter
decides where the next candidates are drawn. The policy that is installed with meanflock is the result.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np

import meanflock.env as env

MISSIONS = ("paper", "swap", "streams")
NEIGHBOURS = 4
ACCELERATION = 4.0  # largest along an axis, m/s²
DIRECTIONS = math.pi / 8 * np.arange(8)
FASTEST = 20.0  # speed up to which the damping is about linear, m/s
# UAVs count as larger in training than in flights, so that a candidate is told before they touch.
TRAINING = {"duration": 60.0, "metrics.collision_radius": 0.5, "reward": {"arrival": 100.0, "collision": -20.0}}
CANDIDATES, BEST, GENERATIONS = 12, 3, 10
NUMBERS = ("speed", "braking", "damping", "wind x", "wind y", "push", "reach", "ahead", "turn")
MEAN = np.array([5.0, 10.0, 0.5, 0.0, 0.0, 0.0, 1.5, 0.5, 0.0])  # flies to its goal and avoids nobody
DEVIATION = np.array([3.0, 5.0, 0.3, 0.2, 0.2, 2.0, 0.7, 0.5, 0.3])


def layers(numbers):
    """Two layers of weights and biases; x and y are treated alike, and so are all neighbours.

    The push is a sum over directions. Along each it is the difference of two tanh of where the neighbour will be in
    `ahead` seconds, in `reach` metres: strong near 0, and nothing far away. `turn` lets all evade to the same side.
    """
    speed, braking, damping, *wind, push, reach, ahead, turn = numbers
    hidden, outputs = [], []
    for axis in (0, 1):
        unit = np.eye(2)[axis]
        for column, scale, strength in ((0, braking, speed), (2, FASTEST, FASTEST)):  # position, velocity
            weights = np.zeros(4 + 6 * NEIGHBOURS)
            weights[column + axis] = 1.0 / scale
            hidden.append(weights)
            outputs.append(-damping * strength * unit)
    for neighbour in range(NEIGHBOURS):
        column = 4 + 6 * neighbour
        for angle in DIRECTIONS:
            for steepness, sign in ((2.0, -1.0), (1.0, 1.0)):
                along = steepness / reach * np.array([math.cos(angle), math.sin(angle)])
                weights = np.zeros(4 + 6 * NEIGHBOURS)
                weights[column : column + 4] = [*along, *(ahead * along)]
                hidden.append(weights)
                outputs.append(sign * push * np.array([math.cos(angle + turn), math.sin(angle + turn)]))
    return [
        (np.array(hidden).T, np.zeros(len(hidden))),
        (np.array(outputs) / ACCELERATION, np.array(wind) / ACCELERATION),
    ]


def saved(file, numbers):
    """The policy of the numbers."""
    return env.save_policy(file, layers(numbers), neighbours=NEIGHBOURS, acceleration=ACCELERATION)


def flown(flights, policy, seed):
    """The mean reward of a UAV in flights that begin with a seed, and their summaries."""
    observations, _ = flights.reset(seed=seed)
    flights.summaries.clear()
    total, ended = 0.0, np.zeros(flights.num_envs, dtype=bool)
    while not ended.all():
        observations, rewards, terminated, truncated, _ = flights.step(policy(observations))
        total += float(rewards[~ended].sum())
        ended |= terminated | truncated
    return total / flights.num_envs, list(flights.summaries)


def train(file, missions, uavs):
    """Searches the numbers on the seeds from 1 on, and saves the mean of the best."""
    rng = np.random.default_rng(1)
    worlds = [env.vector_env(name, flights=1, neighbours=NEIGHBOURS, uavs=uavs, **TRAINING) for name in missions]
    mean, deviation = MEAN, DEVIATION
    for generation in range(1, GENERATIONS + 1):
        candidates = mean + deviation * rng.standard_normal((CANDIDATES, len(mean)))
        rewards = [
            sum(flown(flights, saved(file, numbers), generation)[0] for flights in worlds) for numbers in candidates
        ]
        best = candidates[np.argsort(rewards)[-BEST:]]
        mean, deviation = best.mean(axis=0), best.std(axis=0) + 0.05 * DEVIATION
        print(f"generation {generation}: best reward {max(rewards):.0f}, {time.process_time():.0f} s CPU", flush=True)
    return saved(file, mean), mean


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--missions", nargs="+", default=MISSIONS)
    parser.add_argument("--uavs", type=int, default=25, help="in training; the policy flies any number")
    given = parser.parse_args()
    policy, mean = train(given.file, given.missions, given.uavs)
    print(f"{policy.path}: {', '.join(f'{name} {number:.3f}' for name, number in zip(NUMBERS, mean, strict=True))}")
    for mission in given.missions:
        others = env.vector_env(mission, flights=2, neighbours=NEIGHBOURS)
        _, summaries = flown(others, policy, 1001)
        arrived, uavs, collisions = (
            sum(flight[key] for flight in summaries) for key in ("arrived", "uavs", "collisions")
        )
        print(f"{mission}, seeds of no training: {arrived} of {uavs} UAVs arrive, {collisions} collisions")
