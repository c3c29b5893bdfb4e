"""Transmissions that share bands: how long queues last, who waits for whom, collisions, and what stays the same."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from meanflock.channel.medium import Medium
from meanflock.channel.outlook import outlooks, remedies
from meanflock.channel.queue import slots_of_link, slots_of_queue, success_of
from meanflock.channel.remarks import remarks
from meanflock.federation.plan import plan_of
from meanflock.federation.topology.base import Hop
from meanflock.federation.topology.leader import LeaderTopology
from meanflock.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import RoundEnded
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.stateful import restore, state_of
from meanflock.swarm.wire.messages import FrameKind, LinkColumn
from tests.channel.test_medium import frames, line
from tests.faults.dying import LATER, dead, resumed, steady
from tests.telemetry import Record

SLOW = ("radio.coherence_time_s=0.02", "radio.bandwidth_hz=1000", "radio.latency_threshold_slots=40")


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, list(settings), **options)


def mean(chance: np.ndarray) -> float:
    return float(np.arange(len(chance)) @ chance)


@pytest.mark.parametrize(("needed", "p", "expected"), [(1, 0.8, 1.25), (4, 0.8, 5.0), (12, 0.5, 24.0)])
def test_a_message_lasts_as_a_negative_binomial(needed: int, p: float, expected: float) -> None:
    chance = slots_of_link(needed, 400, p)
    assert chance.sum() == pytest.approx(1.0, abs=1e-12)
    assert mean(chance) == pytest.approx(expected, abs=1e-9)
    assert success_of(needed, 400, expected) == pytest.approx(p, abs=1e-9)


def test_messages_that_cannot_get_through_spend_all_their_slots() -> None:
    assert slots_of_link(9, 8, 0.8).tolist() == slots_of_link(4, 8, 0.0).tolist() == [0.0] * 8 + [1.0]
    assert slots_of_link(4, 8, 1.0).tolist() == [0.0] * 4 + [1.0] + [0.0] * 4
    assert slots_of_queue(slots_of_link(9, 8, 0.8), 1, 24) == 24 * 8


def test_broadcasts_and_queues_last_as_their_closed_forms() -> None:
    """E[max of 24 NB(4, 0.8)] = 7.8 slots, and the tail of a binomial: P[more than D slots] = P[Bin(D, p) < nK]."""
    one = slots_of_link(4, 400, 0.8)
    lasts = np.diff(np.cumsum(one) ** 24, prepend=0.0)
    assert mean(lasts) == pytest.approx(7.8, abs=0.05)
    least = slots_of_queue(one, 1, 20)

    def late(slots: int) -> float:
        return sum(math.comb(slots, k) * 0.8**k * 0.2 ** (slots - k) for k in range(80))

    assert late(least) <= 1e-3 < late(least - 1)


def rounds(uavs: int, needed: int, p: float) -> dict[str, float]:
    """Mean slots of a round by topology and bands, by closed forms; heads are √N of the UAVs."""
    one = slots_of_link(needed, 400, p)
    heads = round(uavs**0.5)

    def slowest(links: int) -> float:
        return mean(np.diff(np.cumsum(one) ** links, prepend=0.0))

    members = [len(part) for part in np.array_split(np.arange(uavs - heads), heads)]
    below = np.ones(heads * 400)
    for count in members:  # the queue of a cluster is within so many slots
        queue = np.ones(1)
        for _ in range(count):
            queue = np.convolve(queue, one)
        below *= np.minimum(np.cumsum(np.pad(queue, (0, len(below) - len(queue)))), 1.0)
    above = (heads - 1) * mean(one) + slowest(uavs - 1)
    return {
        "leader, own": 2 * slowest(uavs - 1),
        "neighbours, own": slowest(uavs * (uavs - 1)),
        "leader": (uavs - 1) * mean(one) + slowest(uavs - 1),
        "neighbours": uavs * slowest(uavs - 1),
        "clusters": (uavs - heads) * mean(one) + above,
        "a band a cluster": float((1.0 - below).sum()) + above,
    }


@pytest.mark.parametrize(
    ("uavs", "needed", "p", "expected"),
    [
        (25, 1, 0.8, {"leader": 32.7, "neighbours": 71.1, "clusters": 32.9, "a band a cluster": 14.3}),
        (25, 4, 0.8, {"leader": 127.8, "neighbours": 195.0, "clusters": 127.7, "a band a cluster": 50.5}),
        (100, 12, 0.5, {"leader": 2415, "neighbours": 3892, "clusters": 2415, "a band a cluster": 494}),
    ],
)
def test_a_leader_is_faster_than_neighbours_in_one_band_and_clusters_with_a_band_each_are_fastest(
    uavs: int, needed: int, p: float, expected: dict[str, float]
) -> None:
    found = rounds(uavs, needed, p)
    for way, slots in expected.items():
        assert found[way] == pytest.approx(slots, rel=0.006)
    assert found["neighbours, own"] < found["leader, own"]  # with a band for each link
    assert 2.0 * found["a band a cluster"] < found["leader"] < found["neighbours"]


THIN = ("radio.coherence_time_s=0.1", "radio.bandwidth_hz=640", "radio.target_snr_db=109")
CLUSTERS, BANDS = "federation.clusters=5", "radio.bands=cluster"


def test_rounds_are_planned_in_the_same_ranking() -> None:
    def planned(*settings: str) -> int:
        hops = plan_of(
            scenario(
                *THIN, "radio.latency_threshold_slots=16", "federation.period=2000", "federation.fraction=1", *settings
            )
        ).hops
        return sum(hop.attempt_ticks for hop in hops)

    leader, neighbours = planned("radio.access=tdma"), planned("radio.access=tdma", "federation.topology=neighbours")
    assert planned("radio.access=tdma", CLUSTERS, BANDS) < 0.7 * leader
    assert leader < neighbours
    assert leader < planned("radio.access=csma") < 2.6 * leader


def test_transmissions_wait_for_one_another_and_cost_what_they_cost_alone() -> None:
    settings = (*SLOW, "radio.target_snr_db=75.3", "uavs=6", "federation.topology=neighbours", "federation.period=300")
    states = line(0, 1, 2, 3, 4, 5)
    sent: dict[str, Any] = {}
    for access in ("fdma", "tdma"):
        medium = Medium(plan_of(scenario(*settings, f"radio.access={access}")))
        first = medium.send(3, [frames(FrameKind.UPLOAD, [0, 1, 2], 20, 1)], states)
        if access == "tdma":  # as after a kill
            again = Medium(plan_of(scenario(*settings, "radio.access=tdma")))
            restore(again, state_of(medium))
            medium = again
        then = medium.send(4, [frames(FrameKind.UPLOAD, [4, 5], 20, 1)], states)
        arrivals = {tick: medium.due(tick) for tick in range(400)}
        sent[access] = np.concatenate([first, then]), medium.meter, arrivals
    (apart, alone, early), (queued, together, late) = sent["fdma"], sent["tdma"]
    assert (apart[:, : LinkColumn.WAITED] == queued[:, : LinkColumn.WAITED]).all()
    assert alone.traffic == together.traffic
    assert not apart[:, LinkColumn.WAITED].any()
    band = 0
    now = {3: 15, 4: 20}  # first slots of the ticks
    for tick, source in ((3, 0), (3, 1), (3, 2), (4, 4), (4, 5)):
        own = queued[(queued[:, LinkColumn.TICK] == tick) & (queued[:, LinkColumn.SOURCE] == source)]
        begin = max(band, now[tick])
        assert (own[:, LinkColumn.WAITED] == begin - now[tick]).all()
        band = begin + int(own[:, LinkColumn.SLOTS].max())

    def ticks(arrivals: Any) -> dict[tuple[int, int], int]:
        return {
            (int(batch.source[row]), int(target)): tick
            for tick, batches in arrivals.items()
            for batch in batches
            for row, target in batch.links
        }

    assert all(ticks(late)[link] >= tick for link, tick in ticks(early).items())
    assert len(ticks(late)) == len(ticks(early))


def test_transmissions_wait_in_the_band_of_their_sender() -> None:
    settings = (*SLOW, "radio.target_snr_db=60", "uavs=6", "federation.period=900", "federation.clusters=2")
    medium = Medium(plan_of(scenario(*settings, "radio.access=tdma", BANDS)))  # UAVs 0 to 2 and 3 to 5; 0 and 3 head
    states = line(0, 1, 2, 3, 4, 5)
    uploads = medium.send(5, [frames(FrameKind.UPLOAD, [1, 2, 4, 5], 20, 1)], states)
    slots, waited = uploads[:, LinkColumn.SLOTS], uploads[:, LinkColumn.WAITED]
    assert waited.tolist() == [0, slots[0], 0, slots[2]]
    told = medium.send(5, [frames(FrameKind.STATE, [0, 4], 4)], states)
    first = {source: told[told[:, LinkColumn.SOURCE] == source][0, LinkColumn.WAITED] for source in (0, 4)}
    assert first == {0: slots[0] + slots[1], 4: slots[2] + slots[3]}
    again = Medium(plan_of(scenario(*settings, "radio.access=tdma", BANDS)))
    restore(again, state_of(medium))
    for one in (medium, again):
        relay = one.send(5, [frames(FrameKind.RELAY, [3], 20, 1)], states)
        assert relay[:, LinkColumn.WAITED].tolist() == [0]
        model = one.send(5, [frames(FrameKind.GLOBAL, [0], 20, 1)], states)
        assert set(model[:, LinkColumn.WAITED]) == {relay[0, LinkColumn.SLOTS]}
        late = one.send(5, [frames(FrameKind.UPLOAD, [1], 20, 2)], states)
        longest = told[told[:, LinkColumn.SOURCE] == 0, LinkColumn.SLOTS].max()
        assert late[0, LinkColumn.WAITED] == slots[0] + slots[1] + longest


def test_contention_costs_unicasts_time_and_nothing_else() -> None:
    settings = (*SLOW, "radio.target_snr_db=75.3", "federation.period=1500")
    states, everyone = line(*range(25)), list(range(25))
    (queued, alone), (contended, together) = (
        (medium.send(3, [frames(FrameKind.UPLOAD, everyone, 20, 1)], states), medium.meter.traffic[FrameKind.UPLOAD])
        for medium in (Medium(plan_of(scenario(*settings, f"radio.access={access}"))) for access in ("tdma", "csma"))
    )
    assert (queued[:, : LinkColumn.WAITED] == contended[:, : LinkColumn.WAITED]).all()
    assert together.airtime_s > alone.airtime_s  # collisions are on the air
    assert dataclasses.replace(together, airtime_s=alone.airtime_s) == alone
    begin = np.argsort(contended[:, LinkColumn.WAITED])
    waited, slots = contended[begin, LinkColumn.WAITED], contended[begin, LinkColumn.SLOTS]
    assert (np.diff(waited) >= slots[:-1] - 1).all()  # waits are rounded up to whole slots
    assert waited[-1] > queued[:, LinkColumn.WAITED].max()


@pytest.mark.parametrize("model", ["rice", "link-budget"])
def test_broadcasts_are_lost_in_collisions_as_often_as_is_foreseen(model: str) -> None:
    channel = (f"radio.model={model}", "radio.range_m=60")
    if model == "link-budget":
        channel += ("radio.options.air_fading=rayleigh", "radio.tx_power_dbm=-25", "radio.coherence_time_s=0.001")
    medium = Medium(plan_of(scenario("radio.access=csma", "radio.target_snr_db=75.3", *channel)))
    states, bill = line(*range(0, 100, 4)), medium.meter.traffic[FrameKind.STATE]
    blocks = []
    for block in range(40):
        before = bill.outages, bill.expected_outages
        for tick in range(20 * block, 20 * block + 20):
            medium.send(tick, [frames(FrameKind.STATE, list(range(25)), 100)], states)
        assert before[1] is not None
        assert bill.expected_outages is not None
        blocks.append(bill.outages - before[0] - (bill.expected_outages - before[1]))
    assert abs(np.mean(blocks)) < 4.0 * np.std(blocks, ddof=1) / len(blocks) ** 0.5
    assert bill.expected_outages is not None
    assert 0.79 < bill.expected_outages / bill.sent < 0.95  # 0.788 in collisions, and the channel's


def test_collisions_are_foreseen_before_take_off() -> None:
    flown = scenario("radio.access=csma", "federation.topology=neighbours", "federation.fraction=1")
    (upload,) = outlooks(flown)
    assert upload.collided == pytest.approx(1.0 - (15 / 16) ** 24)
    assert upload.is_bad
    assert "78.8 % collide" in str(upload)
    assert remedies(flown, "upload").startswith("Use radio.access=tdma (")
    assert [one.collided for one in outlooks(scenario("radio.access=csma"))] == [0.0, 0.0]
    assert any("78.8 % of broadcasts collide" in line for line in remarks(flown))


class Pairs(LeaderTopology):
    """A leader to which even and odd UAVs upload in bands of their own."""

    name = "test-pairs"

    def hops(self) -> tuple[Hop, ...]:
        upload, model = super().hops()
        return msgspec.structs.replace(upload, bands=np.arange(self.scenario.uavs) % 2), model


def test_a_topology_of_a_user_declares_bands() -> None:
    plugins.register(Pairs)
    given = (*SLOW, "uavs=6", "radio.access=tdma", BANDS, "federation.period=900", "radio.target_snr_db=60")
    plan = plan_of(scenario(*given, "federation.topology=test-pairs"))
    links = Medium(plan).send(5, [frames(FrameKind.UPLOAD, [1, 2, 3, 4], 20, 1)], line(*range(6)))
    slots = links[:, LinkColumn.SLOTS]
    assert links[:, LinkColumn.WAITED].tolist() == [0, 0, slots[0], slots[1]]


TDMA, CSMA = ("radio.access=tdma",), ("radio.access=csma",)
WAYS = {
    "leader": TDMA,
    "neighbours": (*TDMA, "federation.topology=neighbours"),
    "clusters": (*TDMA, "federation.clusters=3"),
    "a band a cluster": (*TDMA, "federation.clusters=3", BANDS),
    "leader by contention": CSMA,
    "clusters by contention": (*CSMA, "federation.clusters=3"),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("more", [(), ("federation.fragment=2", "federation.retries=1")])
def test_a_round_in_one_band_waits_for_its_queue(way: str, more: tuple[str, ...]) -> None:
    band = (*WAYS[way], "uavs=9", "radio.target_snr_db=60", "radio.bits_per_float=16", *more)
    thin = ("radio.coherence_time_s=0.02", "radio.bandwidth_hz=10000", "federation.period=900")
    flown = scenario(*band, *thin, "duration=190", "stop=duration")
    summary = Engine(flown, "queue").complete()
    assert (summary["rounds"], summary["rounds_void"], summary["uploads_late"]) == (2, 0, 0)
    assert summary["radio"]["outages"] == 0


@pytest.mark.parametrize("topology", ["federation.topology=neighbours", "federation.topology=leader", CLUSTERS])
def test_models_that_are_sent_again_arrive_in_time_behind_the_acknowledgements(topology: str) -> None:
    shares = {}
    for access in ("fdma", "tdma", *(["csma"] if "neighbours" not in topology else [])):
        lossy = (*THIN, "radio.coherence_time_s=0.02", "radio.bandwidth_hz=3200", "radio.target_snr_db=103.2")
        rounds = ("federation.period=900", "federation.retries=1", "federation.fraction=1", "duration=190")
        record = Record()
        flown = scenario(*lossy, *rounds, topology, f"radio.access={access}", "stop=duration")
        Engine(flown, "again", sinks=[record]).complete()
        ended = [event for event in record.events if isinstance(event, RoundEnded)]
        shares[access] = sum(one.arrived for one in ended) / sum(one.copies for one in ended)
    assert min(shares.values()) > shares["fdma"] - 0.04  # where nobody waits


@pytest.mark.parametrize("way", [*TDMA, *CSMA, "federation.clusters=5"])
def test_a_flight_goes_on_in_the_middle_of_a_queue(way: str, tmp_path: Path) -> None:
    settings = (way,) if way in (*TDMA, *CSMA) else (*TDMA, way, BANDS)
    flown = scenario(*SLOW, "radio.bandwidth_hz=20000", *settings, LATER)
    whole = Engine(flown, "whole").complete()
    queue = [end for end in (hop.attempt_ticks for hop in plan_of(flown).hops) if end > 3]
    assert queue  # so the checkpoint of tick 201 has uploads of tick 200 that wait
    nodes = Engine(flown, "nodes", uavs_per_node=1).complete()
    assert steady(nodes, "run_id", "wire_bytes", "radio") == steady(whole, "run_id", "wire_bytes", "radio")
    back = resumed(dead(tmp_path, flown, 210, rows=7), "--uavs-per-process", "4")
    assert back["trajectory_sha256"] == whole["trajectory_sha256"]
    assert back["radio"]["links"] == whole["radio"]["links"]


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            (*SLOW, "radio.access=tdma", "radio.bandwidth_hz=50"),
            r"`federation.period` 200 has no room .* take at least \d+",
        ),
        (
            (*SLOW, "radio.access=tdma", "radio.bandwidth_hz=50", "federation.topology=neighbours"),
            r"`federation.period` 200 has no room",
        ),
        (("radio.access=tdma", "federation.deadline=5"), "later than an upload can arrive, 0.1 s"),
        (("radio.access=aloha",), "radio.access"),
        ((BANDS,), "`radio.bands` is cluster, but `radio.access` is fdma"),
        (("radio.access=csma", CLUSTERS, BANDS), "`radio.bands` is cluster, but `radio.access` is csma"),
        (("radio.access=tdma", BANDS), "topology leader has no clusters; set `federation.clusters`"),
        (("radio.access=tdma", BANDS, "method=orca"), "topology leader has no clusters"),
        (("radio.access=tdma", BANDS, "federation.topology=neighbours"), "topology neighbours has no clusters"),
        (("radio.contention_slot_s=1e-5",), "`radio.contention_slot_s` has no effect, because `radio.access` is"),
        (("radio.access=csma", "radio.coherence_time_s=3e-5"), "is more than half of `radio.coherence_time_s`"),
        (("radio.access=csma", "uavs=100", "start.spacing=1"), "80 UAVs send acknowledged .* known up to 50"),
    ],
)
def test_what_does_not_fit_into_one_band_is_refused(settings: tuple[str, ...], text: str) -> None:
    with pytest.raises((BadInput, ValueError), match=text):
        plan_of(scenario(*settings))
