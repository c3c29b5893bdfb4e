"""The global model of any rule does not depend on the ticks, batches and order in which uploads came."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.leader.node import Leader
from meanflock.swarm import scenario
from meanflock.swarm.mission import starts
from meanflock.swarm.net import keys
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames, Sense, Welcome

RUN = keys.fingerprint("order")
UAVS, FLOATS, OPENS, CLOSES = 8, 108, 10, 14
# Ties, both zeros, and numbers that vanish beside others; sums of the rough numbers below depend on their order.
NUMBERS = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-40, 1e8, -1e8]), st.floats(-1e6, 1e6, allow_nan=False))


def flown(rule: str) -> Scenario:
    # Uploads come over four ticks; floats of 64 bits show the last bit of a sum.
    slow = ["radio.coherence_time_s=0.1", "radio.latency_threshold_slots=4", "radio.bits_per_float=64"]
    fixed = [f"uavs={UAVS}", f"federation.period={OPENS}", f'federation.aggregation="{rule}"']
    return load(None, [*fixed, *slow], method="mfgfl-h")


def broadcast(of: Scenario, models: np.ndarray, arrivals: list[tuple[int, int]]) -> bytes:
    """The global model of `models` (N, L) that arrive as (tick after the opening, UAV), each in its own batch."""
    node = Leader(Welcome(RUN, "leader", (), 0, scenario.encode(of), starts(of).astype(np.float32)))
    said = b""
    for tick in range(OPENS + 1, CLOSES + 1):
        batches = [
            Frames(FrameKind.UPLOAD, 1, np.array([uav], np.int32), models[[uav]], np.zeros((1, 2), np.int32))
            for after, uav in arrivals
            if OPENS + after == tick
        ]
        for frames in node.act(Sense(RUN, tick, np.zeros((0, 4)), inbox=tuple(batches))).outbox:
            said += frames.payload.tobytes()
    return said


@pytest.mark.parametrize("rule", ["fedavg", "median", "trimmed-mean", "krum"])
def test_the_order_of_arrival_leaves_no_trace_in_the_global_model(rule: str) -> None:
    of = flown(rule)
    orders = st.permutations(range(UAVS))
    ticks = st.lists(st.integers(1, 4), min_size=UAVS, max_size=UAVS)

    @settings(max_examples=25, deadline=None, database=None)
    @given(hnp.arrays(np.float64, (UAVS, 3), elements=NUMBERS), orders, ticks, st.integers(1, UAVS))
    def check(few: np.ndarray, order: list[int], when: list[int], count: int) -> None:
        rough = np.random.default_rng(count).normal(size=(UAVS, FLOATS // 2)) * 10.0 ** np.arange(UAVS)[:, None]
        models = np.concatenate([np.tile(few, FLOATS // 6), rough], axis=-1)
        arriving = sorted(order[:count])
        expected = broadcast(of, models, [(1, uav) for uav in arriving])
        assert len(expected) == 8 * FLOATS * (arriving != [of.federation.leader])
        shuffled = [(when[uav], uav) for uav in order[:count]]
        assert broadcast(of, models, shuffled) == expected

    check()
