"""A round on two levels gives the mean of the models that got through, and pays for each hop."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import meanflock as mf
from meanflock.channel.medium import Medium
from meanflock.federation.party import Party
from meanflock.federation.rules.base import mean
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.clusters import Division
from meanflock.leader.node import Leader
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames, Sense, Welcome
from tests.faults.clusters import CLEAR, FLOATS, PERIOD, ROUGH
from tests.faults.conftest import Lab, scenario
from tests.federation.plugins import Long, Rows

BY_SAMPLES = ("controller.by_samples=true", f"controller.length={FLOATS}")


@pytest.fixture(autouse=True)
def _registered() -> None:
    mf.register(Long)


def one_round(flight: Scenario, models: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray | None, list[int]]:
    """The mean the leader broadcasts of `models` (N, L), and the UAVs whose model got through all hops.

    `samples`: (N,) what each counts, if the controller declares that.
    """
    rounds, air, states = Schedule(flight), Medium(flight), starts(flight)
    agents = Party(flight, "agent", np.arange(flight.uavs), [], Rows(range(flight.uavs)))
    leader = Leader(Welcome(0, "leader", (), 0, scenarios.encode(flight), states))
    tick, relays = PERIOD, np.zeros((0, 5))
    source = rounds.participants(1).astype(np.int32)
    payload = flight.hops[0].coding.pack(models[source], samples[source, None])
    uploads = air.send(tick, [Frames(FrameKind.UPLOAD, 1, source, payload)], states)
    has_heads = flight.federation.clusters > 1
    while not rounds.closes(tick):
        tick += 1
        due = air.due(tick)
        for frames in due:
            if frames.kind == FrameKind.UPLOAD and has_heads:
                agents.check(frames)
                agents.receive(frames, tick)
        sent, refused = agents.act(tick)
        assert not refused
        if sent:
            relays = air.send(tick, sent, states)
        last = FrameKind.RELAY if has_heads else FrameKind.UPLOAD
        act = leader.act(Sense(0, tick, np.zeros((0, 4)), inbox=tuple(f for f in due if f.kind == last)))
    lost, silent = (set(links[links[:, 4] < 0, 1].tolist()) for links in (uploads, relays))
    head_of = Division(flight).head_of if has_heads else np.full(flight.uavs, -1)
    through = [uav for uav in source.tolist() if uav not in lost and head_of[uav] not in silent]
    return (act.outbox[0].payload[0] if act.outbox else None), through


@st.composite
def rounds_of(draw: st.DrawFn) -> tuple[list[str], int]:
    """Settings of a swarm with clusters, and a seed for its models."""
    uavs = draw(st.integers(1, 40))
    return [
        *draw(st.sampled_from([("method=mfgfl-h",), ("method=long", *BY_SAMPLES)])),
        f"uavs={uavs}",
        f"federation.clusters={draw(st.integers(1, uavs))}",
        f"federation.leader={draw(st.integers(0, uavs - 1))}",
        f"federation.fraction={draw(st.floats(0.01, 1.0))}",
        f"seed={draw(st.integers(0, 2**62))}",
        f"federation.period={PERIOD}",
    ], draw(st.integers(0, 2**32))


@pytest.mark.parametrize("radio", [CLEAR, ROUGH], ids=["clear", "rough"])
def test_the_mean_on_one_level_and_on_two_is_that_of_the_models_that_got_through(radio: tuple[str, ...]) -> None:
    @settings(max_examples=40, deadline=None, database=None)
    @given(rounds_of())
    def check(asked: tuple[list[str], int]) -> None:
        for levels in ((), ("federation.clusters=1",)):
            of = load(None, [*asked[0], *radio, *levels])
            draw = np.random.default_rng(asked[1])
            models, samples = draw.standard_normal((of.uavs, FLOATS)), draw.integers(1, 2**16, of.uavs).astype(float)
            found, through = one_round(of, models, samples)
            assert radio is ROUGH or through == Schedule(of).participants(1).tolist()
            assert (found is None) == (set(through) <= {of.federation.leader})  # no model of another UAV arrived
            if found is not None:
                expected = mean(models[through], samples[through] if of.declared.weighted else None)
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)

    check()


@pytest.mark.parametrize(("leader", "bits", "options"), [(0, 32, ()), (5, 64, ()), (7, 16, ()), (0, 64, BY_SAMPLES)])
def test_both_levels_are_billed_as_counted_by_hand(leader: int, bits: int, options: tuple[str, ...]) -> None:
    """8 UAVs, 3 clusters {0 1 2}, {3 4 5}, {6 7}; all upload; five rounds."""
    of = scenario(
        "uavs=8", "federation.clusters=3", "federation.fraction=1.0", f"federation.leader={leader}",
        f"radio.bits_per_float={bits}", "radio.target_snr_db=60", *options, method="long" if options else "mfgfl-h",
    )  # fmt: skip
    samples = 32 if options else 0
    lab = Lab(of)
    summary = lab.fly()
    traffic = summary["radio"]["traffic"]
    assert summary["rounds"] == 5
    assert traffic["uplink"]["transmissions"] == traffic["uplink"]["sent"] == 5 * (8 - 3)  # heads need no radio
    assert traffic["relay"]["transmissions"] == traffic["relay"]["sent"] == 5 * (3 - 1)  # nor does the leader's own
    assert summary["payload_bits"] == {
        "uplink": 25 * (FLOATS * bits + samples),
        "relay": 10 * ((FLOATS + 1) * bits + samples),
        "broadcast": 5 * FLOATS * bits,
        "state": 8 * 4 * bits,
        "total": (30 * FLOATS + 10 * (FLOATS + 1)) * bits + 35 * samples + 32 * bits,
    }
    heads = {0: (0, 3, 6), 5: (0, 5, 6), 7: (0, 3, 7)}[leader]
    members = ((0, 1, 2), (3, 4, 5), (6, 7))
    up = {(uav, head) for head, group in zip(heads, members, strict=True) for uav in group if uav != head}
    relays = {(head, leader) for head in heads if head != leader}
    links = np.concatenate([block.links for block in lab.record.blocks])
    for kind, expected, ticks in ((FrameKind.UPLOAD, up, 0), (FrameKind.RELAY, relays, 1), (FrameKind.GLOBAL, None, 2)):
        of_kind = links[links[:, 3] == kind]
        assert sorted(set(of_kind[:, 0].tolist())) == [20 + ticks, 40 + ticks, 60 + ticks, 80 + ticks, 100 + ticks]
        assert expected is None or {(int(s), int(t)) for _, s, t, _, _ in of_kind} == expected
