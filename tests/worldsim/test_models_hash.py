"""The hash of the models: the same in every mode and after a resume, another one as soon as a bit differs."""

import numpy as np
import pytest

from meanflock.federation.account import ModelsHash
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.worldsim.checkpoint import Resumption
from tests.telemetry import fly

SETTINGS = ["uavs=5", "federation.period=10", 'stop="duration"', "duration=102"]


def flown(*settings: str, method: str = "fed-lspi") -> Scenario:
    return load(None, [*SETTINGS, *settings], method=method)


@pytest.mark.parametrize(
    "settings",
    [(), ("federation.clusters=2",), ('federation.topology="neighbours"', "federation.upload_threshold=0.03")],
    ids=["leader", "clusters", "neighbours"],
)
def test_a_flight_has_one_hash_of_its_models_however_it_is_flown(settings: tuple[str, ...]) -> None:
    of = flown(*settings)
    whole, record = fly(of)
    assert len(whole["models_sha256"]) == 64
    assert fly(of, rows=2)[0]["models_sha256"] == whole["models_sha256"]
    last = max(k for k, block in enumerate(record.blocks) if block.checkpoint)
    past = Resumption.decode(
        record.blocks[last].checkpoint, np.concatenate([block.states for block in record.blocks[: last + 1]])
    )
    assert past.tick > 100
    assert fly(of, resume=past)[0]["models_sha256"] == whole["models_sha256"]


def test_without_rounds_there_is_no_hash() -> None:
    assert Engine(flown(method="plan"), "flight").complete()["models_sha256"] is None


def test_every_bit_counts_and_uploads_do_not_where_a_leader_broadcasts() -> None:
    def hashed(label: FrameKind, *models: float, number: int = 1) -> str | None:
        made = ModelsHash(flown())
        for model in models:
            made.add([Frames(label, number, np.array([0], np.int32), np.array([[model]], np.float32))])
        return made.hexdigest

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
