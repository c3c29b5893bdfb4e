"""Rounds in any topology, also a user's: their ticks and participants, their account in words, and bad settings."""

import json
import re
from typing import Any

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.account import Account, ModelsHash
from meanflock.federation.averager import Averager
from meanflock.federation.memory import OwnModels
from meanflock.federation.plan import plan_of
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop, Topology
from meanflock.launch.engine import Engine
from meanflock.recording.plots import percentages
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import RoundEnded, event_of, fields_of
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.agent import nodes
from tests.federation.plugins import Long, Momentum
from tests.memory_swarm import MemorySwarm
from tests.telemetry import fly

# A radio on which messages need up to five ticks, and many are lost.
SLOW = ("radio.coherence_time_s=0.1", "radio.latency_threshold_slots=5", "radio.target_snr_db=76")


class Ring(Topology):
    """Participants upload to the next UAV and to themselves; averages go one UAV further and replace models there."""

    name = "test-ring"

    def hops(self) -> tuple[Hop, ...]:
        uavs = self.scenario.uavs
        if uavs < 3:
            raise ValueError(f"`federation.topology` is {self.name}, but `uavs` is {uavs}; a ring has three or more")
        everyone = np.arange(uavs)
        following = np.sort(np.stack([everyone, (everyone + 1) % uavs], axis=-1), axis=-1)
        codecs = self.codecs
        averages = codecs.relay(np.full(uavs, 4))
        upload = Hop(FrameKind.UPLOAD, 0, "agent", everyone, following, codecs.upload)
        relay = Hop(FrameKind.RELAY, self.ticks(upload), "agent", everyone, following, averages, "models")
        after = relay.after + self.ticks(relay)
        return (
            upload,
            relay,
            Hop(FrameKind.GLOBAL, after, "agent", everyone, everyone[:, None], codecs.broadcast, "means"),
        )


class ClusterMomentum(Momentum):
    """Averages for a cluster, too."""

    name = "cluster-momentum"
    bears_means = True


UAVS = 9


@pytest.fixture(autouse=True)
def _registered() -> None:
    for plugin in (Ring, Momentum, ClusterMomentum, Long):
        mf.register(plugin)


def scenario(*settings: str, method: str = "mfgfl-h") -> Scenario:
    fixed = [f"uavs={UAVS}", f"federation.topology={Ring.name}", "federation.period=20", "duration=35"]
    return load(None, [*fixed, 'stop="duration"', *settings], method=method, seed=5)


SILENT, DEADLINE = "federation.upload_threshold=0.2", "federation.deadline=0.2"
MEDIAN, MOMENTUM = "federation.aggregation=median", "federation.aggregation=momentum"
LEADER, NEIGHBOURS = "federation.topology=leader", "federation.topology=neighbours"
CLEAR = "radio.target_snr_db=60"  # nothing is lost
CLUSTERS = ("federation.topology=clusters", "federation.clusters=2")
# A tick transmits one of a dozen fragments and more.
FRAGMENTS = ("radio.coherence_time_s=0.0125", "radio.bandwidth_hz=800", "radio.target_snr_db=109", "uavs=6")
FRAGMENTS += ("federation.fragment=3", "federation.period=45", "federation.fraction=1.0", "controller.length=360")
RETRIES, AGAIN = (("federation.retries=3", "federation.period=90"), ("federation.retries=1", "federation.period=90"))
ROWS: dict[str, tuple[str, tuple[str, ...]]] = {
    "a ring": ("mfgfl-h", (*SLOW, "federation.payload=int8")),
    "clusters": ("mfgfl-h", (*SLOW, *CLUSTERS, SILENT)),
    "heads with states": ("mfgfl-h", (*SLOW, *CLUSTERS, f"federation.aggregation={ClusterMomentum.name}")),
    "leader with a state": ("mfgfl-h", (*SLOW, LEADER, MOMENTUM)),
    "late uploads to a leader": ("mfgfl-h", (*SLOW, LEADER, DEADLINE)),
    "neighbours with states, some silent": ("mfgfl-h", (*SLOW, NEIGHBOURS, MOMENTUM, SILENT)),
    "fragments to a leader": ("long", (*FRAGMENTS, LEADER, "federation.payload=int8")),
    "fragments to heads": ("long", (*FRAGMENTS, *CLUSTERS)),
    "fragments to heads, weighted": ("long", (*FRAGMENTS, *CLUSTERS, "controller.by_samples=true")),
    "fragments to neighbours, some silent": ("long", (*FRAGMENTS, NEIGHBOURS, SILENT)),
    "fragments to neighbours with a median": ("long", (*FRAGMENTS, NEIGHBOURS, MEDIAN)),
    "retries to a leader": ("mfgfl-h", (*SLOW, LEADER, *RETRIES)),
    "retries to heads": ("mfgfl-h", (*SLOW, *CLUSTERS, *RETRIES)),
    "retries to neighbours": ("mfgfl-h", (*SLOW, NEIGHBOURS, MEDIAN, *RETRIES)),
    "fragments to a leader, again": ("long", (*FRAGMENTS, LEADER, "federation.payload=int8", *AGAIN)),
    "fragments to heads, again": ("long", (*FRAGMENTS, *CLUSTERS, "controller.by_samples=true", *AGAIN)),
    "fragments to neighbours, again, in part": ("long", (*FRAGMENTS, NEIGHBOURS, *AGAIN, "federation.share=0.5")),
}
STEADY = ("trajectory_sha256", "models_sha256", "payload_bits", "rounds", "rounds_void", "uploads_silent")
STEADY += ("weight_spread_final", "dropped_messages")


@pytest.mark.parametrize("name", ROWS)
def test_a_flight_is_the_same_in_any_number_of_nodes_and_resumed_within_a_round(name: str, monkeypatch) -> None:
    monkeypatch.setattr("meanflock.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
    method, settings = ROWS[name]
    case = scenario(*settings, method=method)
    whole, record = fly(case)
    assert whole["rounds"] > 0
    assert len(whole["models_sha256"]) == 64
    assert (method == "long") == (plan_of(case).hops[0].codec.count > 10)
    assert (SILENT in settings) == (whole["uploads_silent"] > 0)
    assert (DEADLINE in settings) == (whole["uploads_late"] > 0)
    pasts = record.checkpoints[1:]
    assert [past.tick for past in pasts] == [101, 201, 301]  # a round is under way
    others = [fly(case, rows=2)[0], *(fly(case, resume=past)[0] for past in pasts[1:])]
    for field in STEADY:
        assert [other[field] for other in others] == [whole[field]] * len(others), field


def test_a_ring_is_billed_by_the_hop_and_no_uav_pays_for_its_own_model_or_needs_a_leader() -> None:
    engine = MemorySwarm(scenario("federation.fraction=1.0", CLEAR), "ring", uavs_per_node=4)
    assert all(member.role == "agent" for member in engine.nodes.members.present)
    summary = engine.complete()
    traffic: dict[str, Any] = summary["radio"]["traffic"]
    assert traffic["uplink"]["transmissions"] == traffic["uplink"]["delivered"] == 17 * UAVS
    assert traffic["relay"]["payload_bits"] == 17 * UAVS * (108 + 1) * 32
    assert traffic["broadcast"]["sent"] == 0


# -- averaging without a leader -------------------------------------------------------------------------------------

DOUBLES = "radio.bits_per_float=64"


def drawn(case: Scenario) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(case.uavs, plan_of(case).declared.parameters))


def exchanged(case: Scenario, models: np.ndarray, links: np.ndarray) -> np.ndarray:
    """What is made of models (N, L) in a round in which they go over `links` (K, 2): UAV to UAV."""
    plan, everyone = plan_of(case), np.arange(case.uavs)
    averager = Averager(plan.hops[-1], Schedule(plan, everyone), plan, everyone, everyone)
    for batch in np.array_split(links, 3):  # as if they had arrived in three ticks
        source, row = np.unique(batch[:, 0], return_inverse=True)
        ends = np.stack([row, batch[:, 1]], axis=-1).astype(np.int32)
        averager.mail.add(Frames(FrameKind.UPLOAD, 1, source.astype(np.int32), models[source], ends))
    each = np.ones(case.uavs, dtype=bool)
    own = OwnModels(plan.hops[0].codec, case.uavs)
    own.models, own.rounds[:] = models, 1
    rows, averages, *_, refused, failed, waiting = averager.average(1, each, own)
    assert (refused, failed, waiting) == ([], {}, [])
    after = models.copy()
    after[rows] = averages
    return after


APART = np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
PLACES = np.stack(np.divmod(np.arange(9), 3))
GRAPHS = {
    "ring": np.minimum(APART, 9 - APART) <= 1,
    "grid": np.abs(PLACES[:, :, None] - PLACES[:, None]).sum(axis=0) <= 1,
    "random": (np.random.default_rng(2).random((9, 9)) < 0.4) | np.eye(9, dtype=bool),
}


@pytest.mark.parametrize("graph", GRAPHS)
def test_uavs_have_the_mean_of_what_they_received_and_their_own_and_contract_as_the_matrix_says(graph: str) -> None:
    heard, case = GRAPHS[graph], scenario("uavs=9", NEIGHBOURS, DOUBLES)
    mixing = heard / heard.sum(axis=1, keepdims=True)
    models, spreads = drawn(case), []
    for _ in range(30):
        before = models
        models = exchanged(case, before, np.argwhere(heard.T & ~np.eye(9, dtype=bool)))
        np.testing.assert_allclose(models, mixing @ before, atol=1e-12)
        spreads.append(np.ptp(models, axis=0).max())
    second = np.sort(np.abs(np.linalg.eigvals(mixing)))[-2]
    assert graph == "random" or (spreads[-1] / spreads[9]) ** (1 / 20) == pytest.approx(second, rel=0.05)


def test_a_rule_that_is_not_linear_gets_what_was_received_and_the_own_model() -> None:
    case = scenario("uavs=5", NEIGHBOURS, DOUBLES, MEDIAN)
    models = drawn(case)
    after = exchanged(case, models, np.array([[0, 3], [1, 3], [4, 3]]))
    np.testing.assert_array_equal(after[3], np.median(models[[0, 1, 3, 4]], axis=0))
    np.testing.assert_array_equal(after[[0, 1, 2, 4]], models[[0, 1, 2, 4]])  # they heard nobody


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        (lambda uploads: np.zeros(len(uploads.models)), "`weights` has 0.0; each must be greater than 0"),
        (lambda uploads: np.ones(1 + len(uploads.models)), "expected"),
        (lambda uploads: uploads.models[:, 0] * np.nan, "not finite"),
    ],
)
def test_weights_that_are_none_cost_the_round(weights: Any, expected: str) -> None:
    wrong = type("Wrong", (Momentum,), {"name": "wrong", "weights": lambda _self, uploads: weights(uploads)})
    mf.register(wrong)
    summary, sink = fly(scenario("uavs=4", NEIGHBOURS, "federation.aggregation=wrong", "duration=5"))
    assert summary["lost"] == 0
    told = [text for text in sink.texts if "wrong" in text]
    assert told
    assert all("aggregator 'wrong' failed in round" in text and expected in text for text in told)


def test_the_uav_that_would_lead_may_die() -> None:
    summary, _ = fly(scenario("uavs=6", NEIGHBOURS, "faults=[{kind='kill', tick=50, uavs=[0]}]"), rows=2)
    assert (summary["rounds"], summary["rounds_void"], summary["lost"]) == (17, 0, 1)


def test_uavs_out_of_range_are_isolated_keep_their_models_and_are_counted() -> None:
    lonely, _ = fly(scenario("uavs=4", NEIGHBOURS, "start.spacing=20", "federation.range_m=5", "duration=10"))
    assert (lonely["rounds"], lonely["rounds_void"], lonely["rounds_isolated"]) == (0, 4, 16)
    assert lonely["radio"]["traffic"]["uplink"]["sent"] == 0
    near, _ = fly(scenario("uavs=4", NEIGHBOURS, CLEAR, "duration=10"))
    assert (near["rounds"], near["rounds_isolated"]) == (4, 0)
    assert near["weight_spread_final"] < lonely["weight_spread_final"]


def test_a_round_whose_participants_are_all_paused_is_void_and_the_flight_goes_on() -> None:
    pause = "faults=[{kind='pause', tick=15, duration_s=5, uavs=[0, 1, 2]}]"
    summary, _ = fly(scenario("uavs=3", NEIGHBOURS, pause, "duration=10"))
    assert summary["rounds_void"] >= 2
    assert summary["lost"] == 0


# -- ticks, participants and accounts ----------------------------------------------------------------------------------


@pytest.mark.parametrize("slots", [1, 3, 8, 40])
@pytest.mark.parametrize("coherence", [5e-5, 0.025, 0.1, 0.125])
@pytest.mark.parametrize("period", [1, 7, 50])
def test_every_round_that_opens_closes_once_in_order_while_it_is_open(
    period: int, coherence: float, slots: int
) -> None:
    radio = (f"radio.coherence_time_s={coherence}", f"radio.latency_threshold_slots={slots}")
    rounds = Schedule(
        plan_of(nodes.flown(f"federation.period={period}", "federation.fragment=0", *radio, method="mfgfl-h"))
    )
    ticks = range(500)
    opened = [(tick, rounds.opens(tick)) for tick in ticks if rounds.opens(tick)]
    closed = [(tick, rounds.closes(tick)) for tick in ticks if rounds.closes(tick)]
    assert [number for _, number in closed] == list(range(1, len(closed) + 1))
    waits = {end - begin for (begin, _), (end, _) in zip(opened, closed, strict=False)}
    assert waits == {max(1, int(np.ceil(np.round(slots * coherence / 0.1, 9))))}
    wanted = {tick for (begin, _), (end, _) in zip(opened, closed, strict=False) for tick in range(begin + 1, end + 1)}
    assert {tick for tick in range(max(wanted) + 1) if rounds.open_round(tick)} == wanted


@pytest.mark.parametrize(("uavs", "fraction", "expected"), [(25, 0.8, 20), (1, 0.8, 1), (7, 1.0, 7), (10, 0.01, 1)])
@pytest.mark.parametrize("duration", [2.0, 900.0])
def test_every_node_draws_the_agreed_number_of_uavs_ascending_before_or_when_they_are_needed(
    uavs: int, fraction: float, expected: int, duration: float
) -> None:
    keys = (f"uavs={uavs}", f"federation.fraction={fraction}", f"duration={duration}", "federation.period=20")
    case, some = nodes.flown(*keys, method="mfgfl-h"), np.array([0, 2, 3, 11])
    ahead, rows, late = Schedule(plan_of(case), some), Schedule(plan_of(case), some), Schedule(plan_of(case))
    ahead.draw_ahead()
    for number in (1, 10, 11, 128, 129, 130, 2):
        drawn = late.participants(number)
        assert len(drawn) == expected
        assert (np.diff(drawn, prepend=-1, append=uavs) > 0).all()
        for other in (ahead, rows):
            np.testing.assert_array_equal(drawn, other.participants(number))
            assert some[other.rows(number)].tolist() == sorted(set(some) & set(drawn))
    assert len(late.rows(1)) == 0


def test_every_uav_is_drawn_equally_often_within_four_standard_errors() -> None:
    rounds, n = Schedule(plan_of(nodes.flown("uavs=10", "federation.fraction=0.3"))), 2000
    drawn = np.concatenate([rounds.participants(k) for k in range(n)])
    often = np.bincount(drawn, minlength=10) / n
    assert (np.abs(often - 0.3) < 4 * np.sqrt(0.3 * 0.7 / n)).all()


FIVE = ("uavs=5", "duration=12", 'stop="duration"', "federation.period=50", "federation.fraction=1.0")
LIARS = ("federation.byzantine_fraction=0.3", "federation.byzantine_kind=huge")


def test_an_account_counts_each_outcome_and_its_round_names_them_all() -> None:
    account = Account(participants=10, absent=1, sent=[0, 2, 3, 4, 5, 6])
    links = np.array(
        [[20, uav, 1, 0, slots, uav != 3, 0] for uav, slots in ((0, 2), (2, 2), (3, 8), (4, 7))], dtype=np.int32
    )
    account.transmit(links, np.array([3, 3, 3, 3]), np.array([2, 1, 1, 7]), (links[:, 4] > 5) & (links[:, 5] > 0))
    account.receive({0: 3, 2: 2}, 5)
    account.refused, account.earlier = {2}, 1
    account = msgspec.convert(msgspec.to_builtins(account, order="sorted"), Account)
    late = tuple(sorted(account.late - account.received))
    assert (account.ticks, account.parts) == ([2, 1, -1, 7, -1, -1], [3, 2, 0, 0, 0, 0])
    assert (account.received, late, account.copies, account.arrived) == ({0, 2}, (4,), 12, 5)
    ended = RoundEnded(
        21,
        7,
        20,
        "averaged",
        participants=account.participants,
        absent=account.absent,
        sent=tuple(account.sent),
        received=tuple(account.received),
        late=late,
        refused=tuple(account.refused),
        receiver=1,
        copies=account.copies,
        arrived=account.arrived,
        copy="fragments",
        earlier=account.earlier,
        averaging=3,
        isolated=2,
    )
    assert (ended.silent, ended.lost, ended.kind, ended.uavs) == (3, 3, "round", tuple(account.sent))
    assert ended.text == (
        "round 7: 6 of 10 participants sent, 3 silent, 1 absent, 2 received by UAV 1, 3 lost, 1 late (UAV 4), "
        "1 refused (UAV 2), 5 of 12 fragments arrived, 1 late from the round before averaged, too, 2 isolated; "
        "averaged by 3 UAVs"
    )
    np.testing.assert_allclose(percentages([ended]), [[500 / 12, 100 / 6, 30.0]])
    fields = json.loads(json.dumps(fields_of(ended)))
    assert event_of("round-ended", fields) == ended
    for wrong in ({"number": -1}, {"outcome": "perhaps"}, {"sent": 3}, {"airtime_s": None}):
        with pytest.raises(ValueError, match=r"Expected|Invalid"):
            event_of("round-ended", fields | wrong)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            (CLEAR, 'faults=[{kind="kill", tick=10, uavs=[3]}]'),
            "round 1: 4 of 5 participants sent, 1 absent, 4 received by UAV 0; averaged and broadcast, received "
            "by 3 UAVs",
        ),
        (
            (CLEAR, NEIGHBOURS, *LIARS),
            "round 1: 5 of 5 participants sent, 5 received, 2 refused (UAVs 2, 4), 20 of 20 copies arrived; "
            "averaged by 5 UAVs",
        ),
        (
            ("uavs=2", CLEAR, "federation.fraction=0.5", NEIGHBOURS),
            "round 1: 1 of 1 participants sent, 1 received, 1 of 1 copies arrived, 1 isolated; averaged by 1 UAV",
        ),
        (
            ("uavs=2", CLEAR),
            "round 1: 2 of 2 participants sent, 2 received by UAV 0; averaged and broadcast, received by 1 UAV",
        ),
        (
            ("start.spacing=20", "federation.range_m=5", NEIGHBOURS),
            "round 1 is void: no model of another UAV was averaged; 5 of 5 participants sent, 0 received, 5 lost, "
            "5 isolated",
        ),
    ],
)
def test_the_event_of_a_round_is_its_account(settings: tuple[str, ...], expected: str) -> None:
    _, sink = fly(load(None, [*FIVE, *settings], method="mfgfl-h", seed=5))
    event = next(event for event in sink.events if event.kind in ("round", "void"))
    assert event.text == expected
    assert len(event.uavs) == int(re.findall(r"(\d+) of \d+ participants", expected)[0])


def test_every_bit_of_the_models_counts_in_their_hash_but_uploads_do_not_where_a_leader_broadcasts() -> None:
    assert fly(load(None, FIVE, method="plan"))[0]["models_sha256"] is None

    def hashed(label: FrameKind, *models: float, number: int = 1) -> str | None:
        hashes = ModelsHash(plan_of(load(None, FIVE, method="mfgfl-h")))
        for model in models:
            hashes.add([Frames(label, number, np.array([0], np.int32), np.array([[model]], np.float32))])
        return hashes.hexdigest

    two = hashed(FrameKind.GLOBAL, 1.0, 2.0)
    assert two == hashed(FrameKind.GLOBAL, 1.0, 2.0)
    assert two is not None
    others = [
        hashed(FrameKind.GLOBAL, 2.0, 1.0),
        hashed(FrameKind.GLOBAL, 1.0, float(np.nextafter(np.float32(2.0), np.float32(3.0)))),
        hashed(FrameKind.GLOBAL, 1.0, 2.0, number=2),
        hashed(FrameKind.GLOBAL, 1.0),
    ]
    assert len({two, *others}) == 5
    assert hashed(FrameKind.UPLOAD, 1.0) is None


# -- rounds that cannot work ---------------------------------------------------------------------------------------

TWO, RING = "federation.clusters=2", f"federation.topology={Ring.name}"
LONG, FRAGMENT = "controller.length=100000", "federation.fragment=1"
BRIEF = ("federation.period=8", "radio.coherence_time_s=0.05")
QUIET = "federation.upload_threshold=0.1"
# Method, settings, and parts of the line.
REFUSED: list[tuple[str, tuple[str, ...], tuple[str, ...]]] = [
    ("mfgfl-h", ("uavs=4", "federation.clusters=5"), ("federation.clusters", "`uavs` is 4", "at least one")),
    ("mfgfl-h", ("federation.clusters=0",), ("federation.clusters", ">= 1")),
    ("mfg", (TWO,), ("federation.clusters", "`method` mfg", "mfgfl-hf")),
    ("mfgfl-h", (TWO, MEDIAN), ("federation.clusters", "`federation.aggregation` median", "fedavg")),
    ("mfgfl-h", (TWO, *BRIEF), ("federation.clusters", "`federation.period` 8", "up to 8 ticks in all", "at least 9")),
    ("mfgfl-h", (TWO, "uavs=4100", "radio.bits_per_float=16"), ("federation.clusters", "2050 UAVs", "16-bit", "2048")),
    ("mfgfl-h", (NEIGHBOURS, QUIET, MEDIAN), ("false uploads could be a majority",)),
    ("mfgfl-h", (NEIGHBOURS, "federation.upload_threshold=-1"), ("upload_threshold",)),
    ("mfgfl-h", (NEIGHBOURS, TWO), ("`federation.clusters` is 2, but `federation.topology` is neighbours",)),
    ("mfgfl-h", (NEIGHBOURS, "federation.period=1"), ("take at least 2",)),
    ("mfgfl-h", (NEIGHBOURS, "federation.period=5", *SLOW), ("no room for uploads of up to 5 ticks; take at least 6",)),
    ("plan", (NEIGHBOURS,), ("`method` plan has no rounds",)),
    ("mfgfl-h", (RING, "uavs=2"), ("a ring has three or more",)),
    ("mfgfl-h", ("federation.topology=test-rink",), ("did you mean",)),
    ("long", (LONG, "federation.period=3"), ("take at least 4",)),
    ("long", (FRAGMENT, "radio.bandwidth_hz=1000"), ("federation.fragment",)),
    ("long", (LONG, "federation.aggregation=krum"), ("krum",)),
]


@pytest.mark.parametrize(("method", "settings", "parts"), REFUSED)
def test_rounds_that_cannot_work_are_bad_input(method: str, settings: tuple[str, ...], parts: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as caught:
        Engine(load(None, ["uavs=6", "federation.fraction=1.0", *settings], method=method), "refused")
    assert len(str(caught.value).splitlines()) == 1
    for part in parts:
        assert part in str(caught.value)


def test_clusters_at_the_bounds_are_accepted_and_one_leaves_no_trace_in_the_hash() -> None:
    def flown(*settings: str) -> str:
        return load(None, settings, method="mfgfl-h").sha256()

    flown("uavs=4", "federation.clusters=4")
    flown(TWO, "federation.period=9", "radio.coherence_time_s=0.05")
    flown(TWO, "uavs=4096", "radio.bits_per_float=16")
    flown(TWO, "uavs=100000")
    assert load(None, [MEDIAN, "federation.clusters=1"], method="hjb").federation.clusters == 1
    assert flown("federation.clusters=1") == flown() != flown(TWO)
