"""One band for all: how long queues last, who waits for whom, and that nothing but time changes."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.channel.medium import Medium
from meanflock.channel.queue import slots_of_link, slots_of_queue, success_of
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.stateful import restore, state_of
from meanflock.swarm.wire.messages import FrameKind, LinkColumn
from tests.channel.test_medium import frames, line
from tests.faults.dying import LATER, dead, resumed, steady

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


def test_a_round_of_a_leader_is_shorter_in_one_band_and_a_round_of_neighbours_with_a_band_for_each_link() -> None:
    one = slots_of_link(4, 400, 0.8)
    broadcast = mean(np.diff(np.cumsum(one) ** 24, prepend=0.0))
    own = {"leader": 2 * broadcast, "neighbours": mean(np.diff(np.cumsum(one) ** 600, prepend=0.0))}
    shared = {"leader": 24 * mean(one) + broadcast, "neighbours": 25 * broadcast}
    assert own["neighbours"] < own["leader"]
    assert shared["leader"] == pytest.approx(127.8, abs=0.1)
    assert shared["neighbours"] == pytest.approx(195.0, abs=1.0)


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


@pytest.mark.parametrize("topology", ["leader", "neighbours", "clusters"])
@pytest.mark.parametrize("more", [(), ("federation.fragment=2", "federation.retries=1")])
def test_a_round_in_one_band_waits_for_its_queue(topology: str, more: tuple[str, ...]) -> None:
    cluster = ("federation.clusters=3",) if topology == "clusters" else (f"federation.topology={topology}",)
    band = ("radio.access=tdma", "uavs=9", "radio.target_snr_db=60", "radio.bits_per_float=16", *more)
    thin = ("radio.coherence_time_s=0.02", "radio.bandwidth_hz=10000", "federation.period=900")
    flown = scenario(*cluster, *band, *thin, "duration=190", "stop=duration")
    summary = Engine(flown, "queue").complete()
    assert (summary["rounds"], summary["rounds_void"], summary["uploads_late"]) == (2, 0, 0)
    assert summary["radio"]["outages"] == 0


def test_a_flight_goes_on_in_the_middle_of_a_queue(tmp_path: Path) -> None:
    flown = scenario(*SLOW, "radio.bandwidth_hz=20000", "radio.access=tdma", LATER)
    whole = Engine(flown, "whole").complete()
    queue = [end for end in (hop.attempt_ticks for hop in plan_of(flown).hops) if end > 3]
    assert queue  # so the checkpoint of tick 201 has uploads of tick 200 that wait
    nodes = Engine(flown, "nodes", uavs_per_node=1).complete()
    assert steady(nodes, "run_id", "wire_bytes", "radio") == steady(whole, "run_id", "wire_bytes", "radio")
    assert (
        resumed(dead(tmp_path, flown, 210, rows=7), "--uavs-per-process", "4")["trajectory_sha256"]
        == (whole["trajectory_sha256"])
    )


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
    ],
)
def test_what_does_not_fit_into_one_band_is_refused(settings: tuple[str, ...], text: str) -> None:
    with pytest.raises((BadInput, ValueError), match=text):
        plan_of(scenario(*settings))
