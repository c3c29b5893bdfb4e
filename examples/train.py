"""Trains a policy for all UAVs by the cross-entropy method, and saves it: `python examples/train.py out/policy.npz`.

Nine numbers are searched: speed, braking distance and damping, a constant acceleration along x and y against the wind,
and four of the push away from the nearest UAVs. Each candidate flies one flight of each mission; the best quarter
decides where the next candidates are drawn. With `--dimensions 3` it trains for flights in space. The policies that are
installed with meanflock are the results.
"""

import argparse
import math
import time
from pathlib import Path

import numpy as np

import meanflock.env as env

LAYERS = {"start.layers": 3}
MISSIONS = {  # by number of dimensions: names of missions, and keys of each
    2: {"paper": {}, "swap": {}, "streams": {}},
    3: {"paper": LAYERS, "sphere": {}, "streams": LAYERS},
}
NEIGHBOURS = 4
ACCELERATION = 4.0  # largest along an axis, m/s²
_ANGLES = math.pi / 8 * np.arange(8)
DIRECTIONS = {  # unit vectors: half of a circle, and from the centre of a cube to half of its corners, edges and faces
    2: np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1),
    3: np.array([way / np.linalg.norm(way) for way in np.array([*np.ndindex(3, 3, 3)])[14:] - 1.0]),
}
FASTEST = 20.0  # speed up to which the damping is about linear, m/s
# UAVs count as larger in training than in flights, so that a candidate is told before they touch.
TRAINING = {"duration": 60.0, "metrics.collision_radius": 0.5, "reward": {"arrival": 100.0, "collision": -20.0}}
CANDIDATES, BEST, GENERATIONS = 12, 3, 10
NUMBERS = ("speed", "braking", "damping", "wind x", "wind y", "push", "reach", "ahead", "turn")
MEAN = np.array([5.0, 10.0, 0.5, 0.0, 0.0, 0.0, 1.5, 0.5, 0.0])  # flies to its goal and avoids nobody
DEVIATION = np.array([3.0, 5.0, 0.3, 0.2, 0.2, 2.0, 0.7, 0.5, 0.3])


def layers(numbers, dimensions):
    """Two layers of weights and biases; all axes are treated alike, and so are all neighbours.

    The push is a sum over directions. Along each it is the difference of two tanh of where the neighbour will be in
    `ahead` seconds, in `reach` metres: strong near 0, and nothing far away. `turn` lets all evade to the same side.
    """
    speed, braking, damping, *wind, push, reach, ahead, turn = numbers
    state, seen = 2 * dimensions, 2 * dimensions + 2  # numbers of the own state, and of each neighbour
    turned = np.eye(dimensions)
    turned[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    hidden, outputs = [], []
    for axis, unit in enumerate(np.eye(dimensions)):
        for column, scale, strength in ((0, braking, speed), (dimensions, FASTEST, FASTEST)):  # position, velocity
            weights = np.zeros(state + seen * NEIGHBOURS)
            weights[column + axis] = 1.0 / scale
            hidden.append(weights)
            outputs.append(-damping * strength * unit)
    for neighbour in range(NEIGHBOURS):
        column = state + seen * neighbour
        for direction in DIRECTIONS[dimensions]:
            for steepness, sign in ((2.0, -1.0), (1.0, 1.0)):
                along = steepness / reach * direction
                weights = np.zeros(state + seen * NEIGHBOURS)
                weights[column : column + state] = [*along, *(ahead * along)]
                hidden.append(weights)
                outputs.append(sign * push * (turned @ direction))
    biases = np.zeros(dimensions)
    biases[:2] = wind
    return [
        (np.array(hidden).T, np.zeros(len(hidden))),
        (np.array(outputs) / ACCELERATION, biases / ACCELERATION),
    ]


def saved(file, numbers, dimensions):
    """The policy of the numbers."""
    return env.save_policy(file, layers(numbers, dimensions), neighbours=NEIGHBOURS, acceleration=ACCELERATION)


def world(mission, dimensions, flights, **keys):
    """An environment of a mission, in the plane or lifted into space."""
    keys = {"space.dimensions": dimensions} | MISSIONS[dimensions].get(mission, {}) | keys
    return env.vector_env(mission, flights=flights, neighbours=NEIGHBOURS, **keys)


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


def train(file, missions, uavs, dimensions):
    """Searches the numbers on the seeds from 1 on, and saves the mean of the best."""
    rng = np.random.default_rng(1)
    worlds = [world(name, dimensions, 1, uavs=uavs, **TRAINING) for name in missions]
    mean, deviation = MEAN, DEVIATION
    for generation in range(1, GENERATIONS + 1):
        candidates = mean + deviation * rng.standard_normal((CANDIDATES, len(mean)))
        rewards = [
            sum(flown(flights, saved(file, numbers, dimensions), generation)[0] for flights in worlds)
            for numbers in candidates
        ]
        best = candidates[np.argsort(rewards)[-BEST:]]
        mean, deviation = best.mean(axis=0), best.std(axis=0) + 0.05 * DEVIATION
        print(f"generation {generation}: best reward {max(rewards):.0f}, {time.process_time():.0f} s CPU", flush=True)
    return saved(file, mean, dimensions), mean


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--dimensions", type=int, choices=MISSIONS, default=2)
    parser.add_argument("--missions", nargs="+")
    parser.add_argument("--uavs", type=int, default=25, help="in training; the policy flies any number")
    given = parser.parse_args()
    missions = given.missions or list(MISSIONS[given.dimensions])
    policy, mean = train(given.file, missions, given.uavs, given.dimensions)
    print(f"{policy.path}: {', '.join(f'{name} {number:.3f}' for name, number in zip(NUMBERS, mean, strict=True))}")
    for mission in missions:
        others = world(mission, given.dimensions, 2)
        _, summaries = flown(others, policy, 1001)
        arrived, uavs, collisions = (
            sum(flight[key] for flight in summaries) for key in ("arrived", "uavs", "collisions")
        )
        print(f"{mission}, seeds of no training: {arrived} of {uavs} UAVs arrive, {collisions} collisions")
