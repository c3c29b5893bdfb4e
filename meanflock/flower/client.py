"""The ClientApp of a Flower app as a learner: each UAV is a node, and trains when the ServerApp asks it."""

from functools import cache
from typing import Annotated, Any, ClassVar, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Options as NoOptions
from meanflock.agent.learning.base import Fit, Learner, Trained, TrainingFailed, Tree
from meanflock.agent.learning.worker import FIT_S
from meanflock.flower.app import FIRST_NODE, App, bytes_of, cast, context, joined, numbers_in, records_of, split
from meanflock.flower.grid import Asked, asked_first
from meanflock.swarm.errors import FAILURES, last_line
from meanflock.swarm.scenario import Scenario

_EXAMPLES = ("num-examples", "num_examples")


class TrainingRequest(NamedTuple):
    """What the ServerApp asks, as it travels in a note: number of the exchange, mask (N,) of the UAVs that are asked,
    and all of the message but its arrays."""

    number: int
    asked: NDArray[np.bool_]
    rest: bytes

    @classmethod
    def of_asked(cls, number: int, asked: Asked, uavs: int) -> "TrainingRequest":
        """The request of an exchange with a swarm of so many UAVs."""
        return cls(number, np.isin(np.arange(uavs) + FIRST_NODE, asked.nodes), asked.rest)

    @property
    def note(self) -> bytes:
        """The request as bytes."""
        return self.number.to_bytes(2, "little") + np.packbits(self.asked).tobytes() + self.rest

    @classmethod
    def of_note(cls, note: bytes, uavs: int) -> "TrainingRequest":
        """The request in the bytes of a note, of a swarm of so many UAVs."""
        end = 2 + -(-uavs // 8)
        asked = np.unpackbits(np.frombuffer(note[2:end], np.uint8), count=uavs).astype(bool)
        return cls(int.from_bytes(note[:2], "little"), asked, note[end:])


class FlowerClient(Learner):
    """A ClientApp as a learner. `meanflock flower` makes a class of it for its app."""

    app: ClassVar[App]
    trains_again = False  # the ServerApp asks
    runs_programs = True  # Flower Datasets does, to describe the machine

    class Options(NoOptions, frozen=True):
        """The options of an app."""

        run_config: Annotated[dict[str, Any], Meta(description="configuration of the run, over that of the app")] = (
            msgspec.field(default_factory=dict)
        )
        metrics: Annotated[tuple[str, ...], Meta(description="metrics of the ClientApp that are recorded")] = ()
        note_bytes: Annotated[
            int, Meta(ge=32, le=60_000, description="most bytes of configuration and metrics beside a model")
        ] = 192
        state_bytes: Annotated[int, Meta(ge=0, le=1_000_000, description="most bytes of a ClientApp's state")] = 0

    def __init__(self, options: Any, scenario: Scenario, uav: int) -> None:
        super().__init__(options, scenario, uav)
        self._client = self.app.client_app
        self._node = FIRST_NODE + uav
        self._context = context(self._node, self.run_config(options), uav, scenario.uavs)

    @classmethod
    def run_config(cls, options: Any) -> dict[str, Any]:
        """The configuration of a run."""
        return cls.app.config | options.run_config

    @classmethod
    def first(cls, options: Any, scenario: Scenario) -> Asked:
        """The first message of the ServerApp."""
        config = msgspec.json.encode(cls.run_config(options))
        limit_s = float(scenario.federation.options.get("wait_s", FIT_S))
        return _first(*cls.app[:4], config, scenario.uavs, scenario.seed, limit_s)

    @classmethod
    def initial(cls, options: Any, scenario: Scenario) -> Tree:
        """See `Learner.initial`: what the ServerApp sends first, which every UAV has on board at take-off."""
        first = cls.first(options, scenario)
        if not any(array.size for array in first.arrays.values()):
            raise ValueError(
                "the ServerApp sends an empty model; the shapes of a model must not change, so trees that grow, as "
                "those of XGBoost, cannot fly"
            )
        check_note("configuration", TrainingRequest.of_asked(1, first, scenario.uavs).note, options.note_bytes)
        return dict(first.arrays)

    @classmethod
    def takes_part(cls, options: Any, scenario: Scenario, uav: int, config: Fit) -> bool:
        """See `Learner.takes_part`: whether the ServerApp asks the node on this UAV, and the request arrived."""
        request = cls._request(options, scenario, config)
        return request is not None and bool(request.asked[uav])

    @classmethod
    def _request(cls, options: Any, scenario: Scenario, config: Fit) -> TrainingRequest | None:
        """The request beside a global model; None if it was lost. The first one is on board at take-off."""
        if not config.based:
            return TrainingRequest.of_asked(1, cls.first(options, scenario), scenario.uavs)
        return TrainingRequest.of_note(config.note, scenario.uavs) if config.note else None

    def fit(self, model: Tree, config: Fit) -> Trained | None:
        """See `Learner.fit`."""
        request = self._request(self.options, self.scenario, config)
        assert request is not None
        from flwr.app import Message

        assert isinstance(model, dict)
        try:
            reply = self._client(Message(joined(model, request.rest), self._node, "train"), self._context)
            arrays, rest = split(reply.content)
        except FAILURES as error:
            raise TrainingFailed(f"the ClientApp failed: {last_line(self.app.at_fault(error))}") from error
        if (shapes := _shapes(arrays)) != (expected := _shapes(model)):
            raise TrainingFailed(f"the ClientApp returned arrays {shapes}; the ServerApp sent {expected}")
        note = request.number.to_bytes(2, "little") + rest
        check_note("metrics", note, self.options.note_bytes)
        metrics = numbers_in(reply.content)
        examples = next((metrics[name] for name in _EXAMPLES if name in metrics), 1.0)
        return Trained(cast(arrays, model), examples or 1.0, metrics, note)  # the strategy gets the 0 in the note

    def state(self) -> bytes:
        """See `Learner.state`."""
        state, most = bytes_of(self._context.state), self.options.state_bytes
        if len(state) > most:
            raise ValueError(
                f"the ClientApp keeps {len(state)} bytes in `context.state`; set training.options.state_bytes="
                f"{len(state)}, or more if it grows"
            )
        return state

    def load(self, raw: bytes) -> None:
        """See `Learner.load`."""
        self._context.state = records_of(raw)


def check_note(content: str, note: bytes, most: int) -> None:
    """Check that all of a message but its arrays fits into a note.

    Raises:
        ValueError: it does not.
    """
    if len(note) > most:
        raise ValueError(
            f"{content} of {len(note)} bytes; set training.options.note_bytes={len(note)}, or more if it grows"
        )


def _shapes(arrays: dict[str, NDArray[Any]]) -> dict[str, tuple[int, ...]]:
    return {name: array.shape for name, array in arrays.items()}


@cache
def _first(
    folder: str, client: str, server: str, name: str, config: bytes, uavs: int, seed: int, limit_s: float
) -> Asked:
    return asked_first(App(folder, client, server, name, {}), msgspec.json.decode(config), uavs, seed, limit_s)
