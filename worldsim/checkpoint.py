"""All it takes to go on with a run: the state of the world and the minds of the UAVs, between two ticks.

A checkpoint travels in the block of telemetry whose last row it goes on from: the ground keeps the run folder, the
world may have no disk, and whoever has the one has the other. The hash of the trajectory cannot be taken up in the
middle, so whoever resumes a run also brings the states of all ticks flown, which the run folder has.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swarm import codec, model, state
from swarm.errors import BadInput, MessageRejected
from swarm.messages import Act
from swarm.scenario import Scenario
from worldsim.barrier import Barrier
from worldsim.members import Member

SCHEMA = 4
EVERY_TICKS = 100
MAX_BYTES = 24 * 2**20  # a larger one would push the telemetry out of the outbox

Floats = NDArray[np.float64]


class Minds:
    """What the UAVs answered to a Sense that asked for all they know."""

    def __init__(self, scenario: Scenario, whole: bool, models: Floats | None = None) -> None:
        """`whole`: all it takes to go on was asked for, not the models alone. `models`: (N, 246), if all are known."""
        uavs, floats = scenario.uavs, model.shared_floats(scenario.method)
        self.models: Floats = np.full((uavs, model.MODEL_FLOATS), np.nan) if models is None else models
        self.known = np.full((uavs, uavs, state.SIZE), np.nan) if whole and scenario.keeps_states else None
        self.residuals = np.full((uavs, floats), np.nan) if whole and scenario.keeps_residuals else None

    @staticmethod
    def told(scenario: Scenario, whole: bool, barrier: Barrier, by_everyone: bool) -> "Minds":
        """What the nodes reported in the tick of a barrier; `by_everyone`: all UAVs have answered."""
        asked, reports, acts = barrier.asked, barrier.reports, barrier.acts
        if by_everyone and not acts:  # as a rule
            models = np.frombuffer(b"".join([reports[name] for name in asked if name in reports]))
            return Minds(scenario, whole, models.reshape(-1, model.MODEL_FLOATS))
        minds = Minds(scenario, whole)
        for name, said in reports.items():
            minds.models[asked[name].place] = np.frombuffer(said).reshape(-1, model.MODEL_FLOATS)
        for name, act in acts.items():
            minds.take(asked[name], act)
        return minds

    def take(self, member: Member, act: Act) -> None:
        """Enters the answer of one node."""
        if act.report is not None:
            self.models[member.place] = act.report
        if self.known is not None and act.known is not None:
            self.known[member.place] = act.known
        if self.residuals is not None and act.residuals is not None:
            self.residuals[member.place] = act.residuals

    @property
    def sane(self) -> NDArray[np.bool_]:
        """Which UAVs told a model that can be one, `(N,)`."""
        fits: NDArray[np.bool_] = np.maximum.reduce(np.abs(self.models), axis=-1) < model.BEYOND_SENSE  # no NaN is
        return fits

    def complete(self, needed: NDArray[np.bool_]) -> bool:
        """Whether every UAV that is `needed` (N,) has told all."""
        told = np.asarray(np.isfinite(self.models).all(axis=-1))
        if self.known is not None:
            told &= np.isfinite(self.known).all(axis=(-2, -1))
        if self.residuals is not None:
            told &= np.isfinite(self.residuals).all(axis=-1)
        return bool(told[needed].all())

    def snapshot(self) -> dict[str, Any]:
        """All of it; zeros where a UAV is lost and nobody could be asked."""
        parts = {"models": self.models, "known": self.known, "residuals": self.residuals}
        return {name: None if part is None else np.nan_to_num(part) for name, part in parts.items()}


@dataclass(frozen=True)
class Resumption:
    """Where to go on: a checkpoint, and the states (tick + 1, N, 4) of the ticks before it."""

    checkpoint: Mapping[str, Any]
    history: Floats

    @property
    def tick(self) -> int:
        """The first tick to be flown."""
        return int(self.checkpoint["flight"]["tick"])

    @property
    def block(self) -> int:
        """The block of telemetry that carried it."""
        return int(self.checkpoint["block"])

    def minds(self, uavs: NDArray[np.intp]) -> dict[str, Floats]:
        """What a node with these UAVs had learned, the states it knew and its residuals, as far as they are kept."""
        kept = self.checkpoint["minds"]
        parts = {"models": kept["models"], "known": kept["known"], "residuals": kept.get("residuals")}
        return {name: part[uavs] for name, part in parts.items() if part is not None}

    def encode(self) -> bytes:
        """The bytes a world process is started with."""
        return codec.encode_record({"checkpoint": dict(self.checkpoint), "history": self.history})

    @staticmethod
    def of(body: bytes, history: Floats) -> "Resumption":
        """From the bytes of a checkpoint, as telemetry carries them.

        Raises:
            BadInput: it is none.
        """
        return Resumption(_checked(_record(body, "checkpoint")), history)

    @staticmethod
    def load(path: Path) -> "Resumption":
        """From a file with the bytes of `encode`.

        Raises:
            BadInput: the file cannot be read or is something else.
        """
        try:
            record = _record(path.read_bytes(), str(path))
        except OSError as error:
            raise BadInput(f"{path}: {error.strerror}; give a file made by `meanflock resume`") from error
        if set(record) != {"checkpoint", "history"} or not isinstance(record["history"], np.ndarray):
            raise BadInput(f"{path}: not what a run is resumed from; use `meanflock resume`")
        return Resumption(_checked(record["checkpoint"]), record["history"])


def encode(parts: Mapping[str, Any]) -> bytes:
    """The bytes of a checkpoint, as telemetry carries them."""
    return codec.encode_record({"schema": SCHEMA, **parts})


def _record(raw: bytes, what: str) -> dict[str, Any]:
    try:
        return codec.decode_record(raw)
    except MessageRejected as error:
        raise BadInput(f"{what}: damaged ({error}); the run cannot be resumed from it") from error


def _checked(checkpoint: Any) -> Mapping[str, Any]:
    if not isinstance(checkpoint, dict) or checkpoint.get("schema") != SCHEMA:
        raise BadInput(f"the checkpoint is not of schema {SCHEMA}; resume the run with the version that flew it")
    return checkpoint
