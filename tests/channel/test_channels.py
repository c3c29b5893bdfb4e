"""Channels as plug-ins: a channel of a user carries frames, and a wrong one ends the run with its mistake."""

from typing import Any

import numpy as np
import pytest

from meanflock.channel.base import Channel
from meanflock.channel.medium import Medium
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.channel.frames import line
from tests.testing.good import changed


class Disk(Channel):
    """Everything gets through within a radius, in one slot; beyond it nothing does, in two."""

    name = "disk"

    def transmit(self, distance_m: Any, bits: int, rng: np.random.Generator) -> tuple[Any, Any]:
        near = distance_m <= 2.5
        return np.where(near, 1, 2), near


def scenario(*settings: str, **options: Any) -> Scenario:
    return load(None, ["uavs=5", *settings], **options)


def test_a_channel_of_a_user_carries_frames_without_a_closed_form() -> None:
    plugins.register(Disk)
    medium = Medium(scenario("radio.model=disk"))
    sent = [Frames(FrameKind.STATE, 0, np.arange(5, dtype=np.int32), np.ones((5, 4), dtype=np.float32))]
    records = medium.send(3, sent, line(0, 2, 4, 6, 50))
    (batch,) = medium.due(4)
    assert batch.links is not None
    near = [(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2)]
    assert [(int(s), int(t)) for s, t in batch.links] == near
    assert [(int(s), int(t)) for _, s, t, _, slots in records if slots > 0] == near
    assert set(np.abs(records[:, 4]).tolist()) == {1, 2}
    total = medium.meter.traffic[FrameKind.STATE]
    assert (total.sent, total.delivered, total.slots, total.delivered_slots) == (20, 6, 6 + 2 * 14, 6)
    assert (total.expected_outages, total.expected_delivered_slots) == (None, None)
    again = Medium(scenario("radio.model=disk"))
    again.restore(medium.snapshot())
    assert again.meter.traffic == medium.meter.traffic


@pytest.mark.parametrize(("model", "unknown"), [("disk", True), ("ideal", False), ("rice", False)])
def test_a_summary_has_the_closed_forms_there_are(model: str, unknown: bool) -> None:
    plugins.register(Disk)
    radio = Engine(scenario(f"radio.model={model}", "duration=2", method="hjb"), "forms").complete()["radio"]
    assert radio["sent"] > 0
    for name in ("outage_rate_theory", "latency_slots_mean_theory"):
        assert (radio[name] is None) == (radio["traffic"]["state"][name] is None) == unknown
    if model == "ideal":
        assert (radio["outages"], radio["outage_rate_theory"]) == (0, 0.0)
        assert radio["latency_slots_mean"] == radio["latency_slots_mean_theory"] == 1.0


def answering(slots: Any = lambda slots: slots, delivered: Any = lambda delivered: delivered) -> Any:
    return changed(Disk, "transmit", lambda _, answer, *__: (slots(answer[0]), delivered(answer[1])))


@pytest.mark.parametrize(
    ("channel", "expected"),
    [
        (answering(lambda slots: slots[1:]), r"slots: int64 \(19,\), expected int64 \(20,\)"),
        (answering(lambda slots: np.where(slots == 1, 0, 2)), "slots from 0 to 2"),
        (type("Wrong", (Disk,), {"expected": lambda *_: "many"}), "`expected` returns 'many'"),
    ],
)
def test_a_wrong_channel_ends_the_run_with_its_mistake(channel: type, expected: str) -> None:
    plugins.register(channel)
    engine = Engine(scenario("radio.model=disk", "duration=2", method="hjb"), "wrong")
    with pytest.raises(RunFailed, match=f"channel 'disk': .*{expected}"):
        engine.complete()


def test_an_unknown_channel_or_option_is_bad_input() -> None:
    with pytest.raises(BadInput, match=r"'disk' is not installed here; .*; there are ideal, rice"):
        Medium(scenario("radio.model=disk"))
    with pytest.raises(BadInput, match=r"radio\.options"):
        Medium(scenario("radio.options.radius_m=3.0"))
