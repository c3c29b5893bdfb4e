"""The engine in one process: swarms of any size, and the models that it carries from flight to flight."""

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from tests.faults.conftest import RUN, scenario
from tests.golden.flights import steady
from tests.methods import METHODS


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("uavs", [1, 7])
def test_a_swarm_of_one_and_of_an_odd_number_fly(method: str, uavs: int) -> None:
    flown = scenario(f"uavs={uavs}", "duration=3", method=method)
    summary = Engine(flown, RUN, uavs_per_node=2).complete()
    assert (summary["ticks"], summary["uavs"]) == (30, uavs)
    assert (summary["phi_C_distinct"] is None) == (uavs == 1)
    assert not summary["dropped_messages"]


@pytest.mark.parametrize("rows", [1, 4])
def test_models_are_read_and_carried_over_however_the_swarm_is_divided(rows: int) -> None:
    flown = scenario("duration=6", "radio.target_snr_db=76", method="mfgfl-hf")
    whole, divided = Engine(flown, RUN), Engine(flown, RUN, uavs_per_node=rows)
    start = divided.models
    assert start.shape == (6, 246)
    before = whole.complete()
    divided.complete()
    np.testing.assert_array_equal(divided.models, whole.models)
    assert (divided.models != start).any(axis=-1).all()
    memory = {"weights": whole.models}
    again = [Engine(flown, RUN, memory=memory, uavs_per_node=each).complete() for each in (rows, None)]
    assert steady(again[0]) == steady(again[1])
    assert again[0]["trajectory_sha256"] != before["trajectory_sha256"]
