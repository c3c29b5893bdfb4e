"""Clusters: who heads whom, when means are handed on, and that the mean of means is the mean."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.swarm.clusters import Clusters
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.mean import fedavg, pooled, relayed
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind
from meanflock.swarm.wire.relay import Relay

QUICK = settings(max_examples=100, deadline=None, database=None)


def scenario(uavs: int = 12, clusters: int = 3, *more: str, method: str = "mfgfl-h") -> Scenario:
    return load(None, [f"uavs={uavs}", f"federation.clusters={clusters}", *more], method=method)


@st.composite
def swarms(draw: st.DrawFn) -> tuple[int, int, int]:
    """N, K and h."""
    uavs = draw(st.integers(1, 300))
    return uavs, draw(st.integers(1, uavs)), draw(st.integers(0, uavs - 1))


# -- who heads whom -----------------------------------------------------------------------------------------------


@QUICK
@given(swarms())
def test_everybody_has_one_head_which_is_in_the_cluster_it_heads(swarm: tuple[int, int, int]) -> None:
    uavs, count, leader = swarm
    made = Clusters(scenario(uavs, count, f"federation.leader={leader}"))
    assert made.of.tolist() == [i * count // uavs for i in range(uavs)]
    assert (np.bincount(made.of) == made.sizes).all()
    assert made.sizes.max() - made.sizes.min() <= 1
    assert len(made.heads) == len(made.sizes) == count
    assert (np.diff(made.heads) > 0).all()
    assert (made.of[made.heads] == np.arange(count)).all()
    assert (made.head_of == made.heads[made.of]).all()
    assert made.head_of[leader] == leader
    for cluster, head in enumerate(made.heads):
        assert head in (leader, np.flatnonzero(made.of == cluster)[0])


def test_five_of_twenty_five_by_hand() -> None:
    assert Clusters(scenario(25, 5)).heads.tolist() == [0, 5, 10, 15, 20]
    assert Clusters(scenario(25, 5, "federation.leader=7")).heads.tolist() == [0, 7, 10, 15, 20]
    assert Clusters(scenario(7, 3)).of.tolist() == [0, 0, 0, 1, 1, 2, 2]
    assert Clusters(scenario(7, 1, "federation.leader=4")).head_of.tolist() == [4] * 7


# -- when ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("slots", "horizon"), [(8, 1), (40, 4)])
def test_uploads_relays_and_the_mean_are_a_horizon_apart(slots: int, horizon: int) -> None:
    slow = ("federation.period=20", "radio.coherence_time_s=0.01", f"radio.latency_threshold_slots={slots}")
    rounds, flat = Rounds(scenario(12, 3, *slow)), Rounds(scenario(12, 1, *slow))
    for tick in range(100):
        number = tick // 20
        assert rounds.opens(tick) == flat.opens(tick)
        assert rounds.relays(tick) == (number if number and tick % 20 == horizon else 0)
        assert rounds.closes(tick) == (number if number and tick % 20 == 2 * horizon else 0)
        assert rounds.is_open(tick) == (number > 0 and 0 < tick % 20 <= 2 * horizon)
        assert rounds.of(FrameKind.UPLOAD, tick) == rounds.opens(tick)
        assert rounds.of(FrameKind.RELAY, tick) == rounds.relays(tick)
        assert rounds.of(FrameKind.GLOBAL, tick) == rounds.closes(tick)
        assert flat.relays(tick) == 0
        assert flat.closes(tick) == (number if number and tick % 20 == horizon else 0)


def test_who_takes_part_does_not_depend_on_what_was_asked_before() -> None:
    rounds = Rounds(scenario())
    first, _, again = rounds.participants(1).tolist(), rounds.participants(2), rounds.participants(1)
    assert first == again.tolist() == Rounds(scenario()).participants(1).tolist()
    with pytest.raises(ValueError, match="read-only"):
        again[0] = 3


# -- what a scenario may ask --------------------------------------------------------------------------------------

REFUSED = {
    "more clusters than UAVs": (("uavs=4", "federation.clusters=5"), "mfgfl-h", ("`uavs` is 4", "at least one")),
    "no cluster at all": (("federation.clusters=0",), "mfgfl-h", ("federation.clusters", ">= 1")),
    "a method without rounds": (("federation.clusters=2",), "mfg", ("`method` mfg", "mfgfl-hf")),
    "a rule that must see every upload": (
        ("federation.clusters=2", "federation.aggregation=median"),
        "mfgfl-h",
        ("`federation.aggregation` median", "fedavg"),
    ),
    "no room for two hops": (
        ("federation.clusters=2", "federation.period=8", "radio.coherence_time_s=0.05"),
        "mfgfl-h",
        ("`federation.period` 8", "up to 4 ticks", "at least 9"),
    ),
    "more models than half a float counts": (
        ("uavs=4100", "federation.clusters=2", "radio.bits_per_float=16"),
        "mfgfl-h",
        ("2050 UAVs", "16-bit", "2048"),
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_clusters_that_cannot_work_are_bad_input_that_says_what_to_change(what: str) -> None:
    asked, method, parts = REFUSED[what]
    with pytest.raises(BadInput) as caught:
        load(None, asked, method=method)
    assert len(str(caught.value).splitlines()) == 1
    for part in ("federation.clusters", *parts):
        assert part in str(caught.value)


def test_at_the_bounds_clusters_fly() -> None:
    scenario(4, 4)
    scenario(12, 3, "federation.period=9", "radio.coherence_time_s=0.05")
    scenario(4096, 2, "radio.bits_per_float=16")
    scenario(100_000, 2)
    assert load(None, ["federation.aggregation=median", "federation.clusters=1"], method="hjb").federation.clusters == 1


def test_one_cluster_leaves_no_trace_in_the_hash() -> None:
    assert scenario(12, 1).sha256() == load(None, ["uavs=12"], method="mfgfl-h").sha256()
    assert scenario(12, 2).sha256() != scenario(12, 1).sha256()


# -- the mean of means --------------------------------------------------------------------------------------------


@QUICK
@given(
    hnp.arrays(np.float64, st.tuples(st.integers(1, 40), st.integers(1, 5)), elements=st.floats(-1e3, 1e3)),
    st.data(),
)
def test_the_mean_of_means_weighed_by_their_counts_is_the_mean(models: np.ndarray, data: st.DataObject) -> None:
    heads = data.draw(st.lists(st.integers(0, 6), min_size=len(models), max_size=len(models)))
    of = {head: relayed({uav: models[uav] for uav in range(len(models)) if heads[uav] == head}) for head in set(heads)}
    assert sum(relay[-1] for relay in of.values()) == len(models)
    scale = np.abs(models).max(axis=0)
    assert (np.abs(pooled(of) - fedavg(models)) <= 1e-14 * len(models) * scale).all()
    order = data.draw(st.permutations(sorted(of)))
    assert pooled({head: of[head] for head in order}).tobytes() == pooled(of).tobytes()


def test_one_head_s_mean_is_the_mean_and_nothing_has_none() -> None:
    models = {3: np.array([1.0, 2.0]), 5: np.array([3.0, 6.0])}
    assert relayed(models).tolist() == [2.0, 4.0, 2.0]
    assert pooled({3: relayed(models)}).tolist() == [2.0, 4.0]
    assert pooled({0: np.array([1.0, 0.0, 3.0]), 4: np.array([5.0, 4.0, 1.0])}).tolist() == [2.0, 1.0]
    for empty in (relayed, pooled):
        with pytest.raises(ValueError, match="at least one"):
            empty({})


# -- how it is written --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [16, 32, 64])
@pytest.mark.parametrize(("method", "floats"), [("mfgfl-h", 108), ("mfgfl-f", 138), ("mfgfl-hf", 246)])
def test_a_relay_is_the_model_and_one_more_float(bits: int, method: str, floats: int) -> None:
    of = scenario(12, 3, f"radio.bits_per_float={bits}", "federation.payload=int8", method=method)
    relay = Relay(of)
    assert relay.bits == (floats + 1) * bits
    said = relay.encode(np.full((2, floats + 1), 3.0))
    assert said.nbytes * 8 == 2 * relay.bits
    assert (relay.decode(said) == 3.0).all()
    relay.check_relays(np.array([0, 8], np.int32), said)
    beyond = np.full((1, floats + 1), 1e300)
    assert relay.sound(relay.encode(beyond)).tolist() == [bits == 64]


WRONG = {
    "of nobody": ([0], 0.0),
    "of a half": ([0], 1.5),
    "of more than the cluster has": ([0], 5.0),
    "of fewer than none": ([4], -1.0),
    "of infinitely many": ([4], np.inf),
    "of no number": ([4], np.nan),
    "of a UAV that heads nothing": ([5], 2.0),
    "of a UAV that is nowhere": ([99], 2.0),
    "of a negative UAV": ([-1], 2.0),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_relay_that_cannot_be_is_refused(what: str) -> None:
    source, count = WRONG[what]
    relay = Relay(scenario())
    said = np.zeros((1, relay.width), np.float32)
    said[0, -1] = 2.0
    relay.check_relays(np.array([0], np.int32), said)
    said[0, -1] = count
    with pytest.raises(MessageRejected) as caught:
        relay.check_relays(np.array(source, np.int32), said)
    assert caught.value.reason == "wrong-shape"


@pytest.mark.parametrize("said", [np.ones((1, 108), "<f4"), np.ones((2, 109), "<f4"), np.ones((1, 109)), np.ones(109)])
def test_a_relay_of_another_shape_is_refused(said: np.ndarray) -> None:
    with pytest.raises(MessageRejected, match="wrong-shape"):
        Relay(scenario()).check_relays(np.array([0], np.int32), said)
