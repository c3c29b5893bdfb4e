"""Models that are transmitted again where no acknowledgement came, and uploads of only what moved."""

from collections import Counter
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.codec import Codec, Cut
from meanflock.federation.cut import coding_of
from meanflock.federation.memory import Feedback, Sent
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.swarm.events import FragmentsReceived, RoundEnded
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind
from tests.federation.channels import Coin
from tests.federation.plugins import Long
from tests.memory_swarm import MemorySwarm
from tests.telemetry import Record

UAVS, LENGTH = 6, 1200
WHOLE, CUT = "federation.fragment=0", "federation.fragment=1"
TOPOLOGIES = ("federation.topology=leader", "federation.clusters=2", "federation.topology=neighbours")
CLEAR, LOSSY = "radio.model=ideal", f"radio.model={Coin.name}"


class Arrivals(Long):
    """Counts the global models of each round that a UAV was given, and those of them that were whole."""

    name = "arrivals"

    def init(self, uavs: np.ndarray, initial_states: np.ndarray) -> dict[str, Any]:
        return super().init(uavs, initial_states) | {"arrivals": np.zeros((len(uavs), 2, 100))}

    def arrived(self, memory: dict[str, Any], rows: np.ndarray, arrival: Any) -> dict[str, Any]:
        arrivals = memory["arrivals"].copy()
        arrivals[rows, 0, arrival.number] += 1
        arrivals[rows, 1, arrival.number] += arrival.whole
        return self.set(memory, rows, arrival.models) | {"arrivals": arrivals}


@pytest.fixture(autouse=True)
def _registered() -> None:
    for plugin in (Arrivals, Coin, Long):
        mf.register(plugin)


def scenario(*settings: str, method: str = "arrivals") -> Scenario:
    fixed = [f"uavs={UAVS}", f"controller.length={LENGTH}", 'stop="duration"', "duration=32", "federation.period=20"]
    return load(None, [*fixed, "federation.fraction=1.0", *settings], method=method, seed=4)


class Flight:
    """A flight, with the models and acknowledgements that went on the air, by kind."""

    def __init__(self, case: Scenario) -> None:
        self.record = Record()
        self.engine = engine = Engine(case, "retries", sinks=[self.record])
        self.models, self.acknowledgements = Counter[FrameKind](), Counter[FrameKind]()
        send, acknowledge = engine.world.air.send, engine.world.air.acknowledge
        targets = {hop.label: hop.targets for hop in plan_of(case).hops}

        def tell(tick: int, frames: list[Any], *rest: Any) -> Any:
            for batch in frames:
                if batch.kind != FrameKind.STATE:
                    to = targets[batch.kind]
                    is_own = np.zeros(len(batch.source), bool) if to is None else to[batch.source, 0] == batch.source
                    self.models[batch.kind] += int(np.count_nonzero(~is_own))
            return send(tick, frames, *rest)

        def acknowledged(tick: int, states: Any, cut: Any, noise: Any, kind: FrameKind, *rest: Any) -> Any:
            delivered = acknowledge(tick, states, cut, noise, kind, *rest)
            self.acknowledgements[kind] += len(delivered)
            return delivered

        engine.world.air.send, engine.world.air.acknowledge = tell, acknowledged
        self.summary = engine.complete()

    @property
    def rounds(self) -> list[RoundEnded]:
        return [event for event in self.record.events if isinstance(event, RoundEnded)]

    @property
    def share(self) -> float:
        """Share of the messages of uploads, over links to other UAVs, that were there when their round was averaged."""
        return sum(one.arrived for one in self.rounds) / sum(one.copies for one in self.rounds)


@pytest.mark.parametrize("cut", [WHOLE, CUT], ids=["whole", "fragments"])
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_on_a_radio_that_loses_half_three_retries_bring_fifteen_of_sixteen_and_all_is_billed(
    topology: str, cut: str
) -> None:
    once, again = (Flight(scenario(LOSSY, topology, cut, f"federation.retries={n}")) for n in (0, 3))
    plan = plan_of(again.engine.world.scenario)
    assert (plan.hops[0].codec.count > 10) == (cut == CUT)
    links = sum(one.copies for one in once.rounds)
    assert abs(once.share - 1 / 2) < 4 * np.sqrt(1 / 4 / links)
    assert abs(again.share - 15 / 16) < 4 * np.sqrt(15 / 256 / links)
    assert all(one.arrived <= one.copies for one in again.rounds)
    assert not once.acknowledgements
    assert again.engine.world.ledger.retries > 0
    ack_bits = 32 + 8 * -(-plan.hops[0].codec.count // 8)
    labels = {FrameKind.UPLOAD: "uplink", FrameKind.RELAY: "relay", FrameKind.GLOBAL: "broadcast"}
    for hop in plan.hops:
        if not hop.is_local:
            sent, acknowledged = again.models[hop.label], again.acknowledgements[hop.label]
            bill = again.summary["radio"]["traffic"][labels[hop.label]]
            assert bill["payload_bits"] == sent * hop.codec.bits + acknowledged * ack_bits
            assert bill["transmissions"] == sent + acknowledged
            assert acknowledged > 0
    before, after = (flight.engine.crew.agents[0]._memory["arrivals"] for flight in (once, again))
    assert after.max() == 1  # a copy that comes twice is taken once
    assert after[:, 1].sum() > before[:, 1].sum() or "neighbours" in topology


@pytest.mark.parametrize("cut", [WHOLE, CUT], ids=["whole", "fragments"])
def test_where_nothing_is_lost_nothing_is_sent_again_and_each_receiver_acknowledges_once(cut: str) -> None:
    flight = Flight(scenario(CLEAR, cut, "federation.retries=3", TOPOLOGIES[0]))
    assert flight.engine.world.ledger.retries == 0
    codec, rounds, others = plan_of(flight.engine.world.scenario).hops[0].codec, flight.summary["rounds"], UAVS - 1
    ack_bits = 32 + 8 * -(-codec.count // 8)
    assert rounds == 15
    assert flight.acknowledgements == {FrameKind.UPLOAD: rounds * others, FrameKind.GLOBAL: rounds * others}
    assert flight.summary["payload_bits"]["uplink"] == rounds * others * (codec.count * codec.bits + ack_bits)
    assert flight.summary["payload_bits"]["broadcast"] == rounds * (codec.count * codec.bits + others * ack_bits)


@pytest.mark.parametrize(("topology", "least"), [(TOPOLOGIES[0], 8), (TOPOLOGIES[1], 12), (TOPOLOGIES[2], 5)])
def test_a_round_has_room_for_its_retries_or_is_refused_with_the_least_period(topology: str, least: int) -> None:
    settings = (CLEAR, topology, "federation.retries=3")
    with pytest.raises(mf.BadInput, match=f"take at least {least}$"):
        plan_of(scenario(*settings, f"federation.period={least - 1}"))
    assert Flight(scenario(*settings, f"federation.period={least}", "duration=5")).summary["rounds"] > 0


def test_who_received_a_whole_model_is_counted_when_its_last_attempt_is_over() -> None:
    """One attempt reaches half of the five others, four reach 15 of 16."""
    once, again = (Flight(scenario(LOSSY, TOPOLOGIES[0], WHOLE, f"federation.retries={n}")) for n in (0, 3))
    counted = [event for event in again.record.events if isinstance(event, FragmentsReceived)]
    assert [event.number for event in counted] == [one.number for one in again.rounds]
    assert {one.reached for one in again.rounds} == {None}
    assert all((event.fragments, event.whole + event.nothing) == (1, UAVS - 1) for event in counted)
    share = sum(event.whole for event in counted) / (UAVS - 1) / len(counted)
    assert abs(share - 15 / 16) < 4 * np.sqrt(15 / 256 / (UAVS - 1) / len(counted))
    assert not any(isinstance(event, FragmentsReceived) for event in once.record.events)
    assert sum(one.reached or 0 for one in once.rounds) < sum(event.whole for event in counted)


# -- uploads of what moved -----------------------------------------------------------------------------------------


def test_the_first_model_always_goes_and_then_only_one_that_has_moved() -> None:
    """By hand: the norm of the change over that of the model sent last."""
    sent, rows = Sent(Codec(coding_of(Scenario(), "float64"), (2,)), 3, 0.1), np.arange(3)
    assert sent.due(rows, np.array([[3.0, 4.0], [1.0, 0.0], [0.0, 0.0]])).all()
    moved = np.array([[3.0, 4.6], [1.05, 0.0], [1e-9, 0.0]])
    assert sent.due(rows, moved).tolist() == [[True], [False], [True]]
    again = np.array([[3.0, 4.6], [1.101, 0.0], [1e-9, 0.0]])
    assert sent.due(rows, again).tolist() == [[False], [True], [False]]


def test_the_fragments_that_moved_most_since_they_were_sent_go() -> None:
    """By hand: three fragments of two weights, a third of them each time."""
    sent = Sent(Codec(coding_of(Scenario(), "float64"), (6,), Cut(1, 2, 9)), 2, 0.0, share=1 / 3)
    rows = np.arange(2)
    assert sent.due(rows, np.ones((2, 6))).all()  # the first time all of it
    moved = np.array([[1.0, 1.1, 1.0, 1.3, 1.2, 1.0], [1.5, 1.0, 1.4, 1.4, 1.0, 1.0]])
    assert sent.due(rows, moved).tolist() == [[False, True, False], [False, True, False]]
    assert sent.due(rows, moved).tolist() == [[False, False, True], [True, False, False]]
    assert sent.due(rows[:1], moved[:1]).tolist() == [[True, False, False]]
    assert not sent.due(rows, moved).any()


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_after_the_first_upload_a_share_of_the_fragments_is_sent_and_billed(topology: str) -> None:
    settings = (CLEAR, CUT, topology, "federation.share=0.25", "controller.decay=0.99")
    flight = Flight(scenario(*settings))
    codec, rounds = plan_of(flight.engine.world.scenario).hops[0].codec, flight.summary["rounds"]
    part = round(0.25 * codec.count)
    assert 1 < part < codec.count
    free = {TOPOLOGIES[0]: 1, TOPOLOGIES[1]: 2, TOPOLOGIES[2]: 0}[topology]  # heads' own models
    assert flight.models[FrameKind.UPLOAD] == (UAVS - free) * (codec.count + (rounds - 1) * part)
    assert flight.summary["payload_bits"]["uplink"] == flight.models[FrameKind.UPLOAD] * codec.bits
    others = MemorySwarm(scenario(*settings), "share", uavs_per_node=4).complete()
    for field in ("models_sha256", "payload_bits", "dropped_messages"):
        assert others[field] == flight.summary[field]


def test_the_rounding_error_of_a_fragment_that_is_not_sent_stays() -> None:
    case = load(None, ("federation.payload=int8",))
    codec = Codec(coding_of(case, "int8"), (8,), Cut(1, 4, 9))
    feedback, row = Feedback(codec, np.array([0]), active=True), np.array([0])
    draw = np.random.default_rng(1)
    feedback.encode(row, draw.normal(size=(1, 8)), 1)
    assert feedback.residuals is not None
    before = feedback.residuals.copy()
    feedback.encode(row, draw.normal(size=(1, 8)), 2, np.array([[True, False]]))
    assert (feedback.residuals[0, 4:] == before[0, 4:]).all()
    assert (feedback.residuals[0, :4] != before[0, :4]).any()
