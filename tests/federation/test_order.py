"""Whatever the rule, what the leader broadcasts does not depend on when, in which batch and order uploads came."""

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
# Ties, both zeros, numbers that vanish beside others, and numbers whose sum depends on its order.
NUMBERS = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-40, 1e8, -1e8]), st.floats(-1e6, 1e6, width=32, allow_nan=False)
)


def flown(rule: str) -> Scenario:
    slow = ["radio.coherence_time_s=0.1", "radio.latency_threshold_slots=4"]  # uploads come over four ticks
    fixed = [f"uavs={UAVS}", f"federation.period={OPENS}", f'federation.aggregation="{rule}"']
    return load(None, [*fixed, *slow], method="mfgfl-h")


def broadcast(of: Scenario, models: np.ndarray, arrivals: list[tuple[int, int]]) -> bytes:
    """What the leader says when `models` (N, L) arrive as (tick after the opening, UAV), each in a batch of its own."""
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
def test_the_order_of_arrival_leaves_no_trace_in_what_the_leader_broadcasts(rule: str) -> None:
    of = flown(rule)
    orders = st.permutations(range(UAVS))
    ticks = st.lists(st.integers(1, 4), min_size=UAVS, max_size=UAVS)

    @settings(max_examples=40, deadline=None, database=None)
    @given(hnp.arrays(np.float32, (UAVS, 3), elements=NUMBERS), orders, ticks, st.integers(1, UAVS))
    def check(few: np.ndarray, order: list[int], when: list[int], count: int) -> None:
        models = np.tile(few, FLOATS // 3)
        arriving = sorted(order[:count])
        expected = broadcast(of, models, [(1, uav) for uav in arriving])
        assert len(expected) == 4 * FLOATS * (arriving != [of.federation.leader])
        shuffled = [(when[uav], uav) for uav in order[:count]]
        assert broadcast(of, models, shuffled) == expected

    check()
