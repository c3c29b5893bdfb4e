"""Where the swarm stands at t = 0."""

import math

import numpy as np
import pytest

from meanflock.swarm import state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import load


@pytest.mark.parametrize("uavs", [1, 2, 3, 4, 7, 9, 24, 25, 26, 200])
def test_everyone_stands_still_on_the_grid_and_nobody_shares_a_place(uavs: int) -> None:
    states = starts(load(None, [f"uavs={uavs}"]))
    assert states.shape == (uavs, state.SIZE)
    assert not states[:, state.VELOCITY].any()
    position = states[:, state.POSITION]
    steps = (position - position[0]) / math.sqrt(2)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert len({tuple(row) for row in np.round(steps).tolist()}) == uavs
    width = math.ceil(math.sqrt(uavs))
    assert steps.max() <= width - 1 + 1e-9


@pytest.mark.parametrize("uavs", [1, 4, 9, 25, 196])
def test_a_full_square_is_centred_where_the_scenario_says(uavs: int) -> None:
    position = starts(load(None, [f"uavs={uavs}"]))[:, state.POSITION]
    np.testing.assert_allclose(position.mean(axis=0), [150.0, 100.0], atol=1e-9)
    np.testing.assert_allclose((position.min(axis=0) + position.max(axis=0)) / 2, [150.0, 100.0], atol=1e-9)


def test_neighbours_are_as_far_apart_as_the_scenario_says() -> None:
    position = starts(load(None, ["start.spacing=3.0"]))[:, state.POSITION]
    apart = np.sqrt(((position[:, None] - position[None]) ** 2).sum(axis=-1))
    np.testing.assert_allclose(np.where(apart == 0, np.inf, apart).min(axis=1), 3.0)


def test_seven_fill_rows_of_three_and_leave_the_last_short() -> None:
    position = starts(load(None, ["uavs=7", "start.spacing=1.0", "start.centre=[0.0, 0.0]"]))
    found = position[:, state.POSITION].tolist()
    assert found == [[-1, -1], [0, -1], [1, -1], [-1, 0], [0, 0], [1, 0], [-1, 1]]
