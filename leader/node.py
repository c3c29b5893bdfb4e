"""The leader node: collects the uploads of a round, averages them when the round closes, broadcasts the result.

Where clusters have heads it collects their relays instead: a mean, and the number of models to weigh it by. A round is
void, and changes nothing, unless it has a model of another UAV than the leader's.
"""

import numpy as np

from meanflock.leader.aggregators.base import Aggregator, State
from meanflock.swarm import plugins, state
from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.failures import FAILURES, last_line
from meanflock.swarm.kept import check_again, check_kept
from meanflock.swarm.mean import pooled, refuse, stacked
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import decode
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import payload
from meanflock.swarm.wire.control import decode_record, encode_record
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense, Welcome
from meanflock.swarm.wire.relay import Relay


class Leader:
    """What the leader does with a Sense; whoever carries the messages calls `act`."""

    def __init__(self, welcome: Welcome) -> None:
        self.complaints: list[str] = []  # what the world should hear of, since it was last asked
        self._scenario = scenario = decode(welcome.scenario)
        self._rounds = Rounds(scenario)
        self._up, self._down = payload.upload(scenario), payload.broadcast(scenario)
        federation = scenario.federation
        self._relay = Relay(scenario) if federation.clusters > 1 else None
        self._rule: Aggregator = plugins.create("aggregator", federation.aggregation, federation.options, scenario)
        self._state = self._begin(scenario.declared.parameters)
        self._kept = b""  # that, as a record
        self._arrived: dict[int, dict[int, Floats]] = {}  # round → UAV → model, or relay

    def act(self, sense: Sense) -> Act:
        """One tick.

        Raises:
            MessageRejected: the Sense does not fit; nothing has changed.
        """
        for frames in sense.inbox:
            self._check(frames)
        if sense.memory:  # it takes over from another, or goes on with a run
            self._state = decode_record(sense.memory)

        # 1. Collect what arrived, by round and UAV; a second copy of the same upload changes nothing.
        for frames in sense.inbox:
            of_round = self._arrived.setdefault(frames.round, {})
            models = (self._relay or self._up).decode(frames.payload)
            for uav, model in zip(frames.source.tolist(), models, strict=True):
                of_round.setdefault(uav, model)
        # 2. When the round closes, refuse what cannot be a model, average and broadcast the rest, if the radio brought
        #    any of it.
        number = self._rounds.closes(sense.tick)
        arrived, refused = refuse(self._arrived.get(number, {}))
        self._arrived = {later: models for later, models in self._arrived.items() if later > number}
        self._kept = b""
        outbox = self._broadcast(number, arrived) if self._has_models_of_others(number, arrived) else ()
        return Act(
            sense.run,
            sense.tick,
            np.zeros((0, state.AXES)),
            refused=~np.array(refused, dtype=np.int32),
            memory=self._kept,
            outbox=outbox,
        )

    def _begin(self, parameters: int) -> State:
        name = self._scenario.federation.aggregation
        try:
            begun = self._rule.init(parameters)
            _recorded(begun)
            return begun
        except FAILURES as error:
            raise BadInput(f"aggregator {name!r} failed in `init`: {last_line(error)}") from error

    def _has_models_of_others(self, number: int, arrived: dict[int, Floats]) -> bool:
        """Whether a model in `arrived` comes from another UAV than the one that averages."""
        leader = self._scenario.federation.leader
        if arrived.keys() - {leader}:
            return True
        if self._relay is None or leader not in arrived:
            return False
        return arrived[leader][-1] > float(leader in self._rounds.participants(number))

    def _broadcast(self, number: int, arrived: dict[int, Floats]) -> tuple[Frames, ...]:
        model = self._averaged(number, arrived)
        if model is None:
            return ()
        said = self._down.encode(model[None])
        if not self._down.sound(said).all():
            self.complaints.append(f"round {number}: the global model is beyond what the radio's floats can say")
            return ()
        return (Frames(FrameKind.GLOBAL, number, np.array([self._scenario.federation.leader], dtype=np.int32), said),)

    def _averaged(self, number: int, arrived: dict[int, Floats]) -> Floats | None:
        """The global model (parameters,); None where the rule fails, which may be anybody's."""
        if self._relay is not None:
            return pooled(arrived)
        width, name = self._scenario.declared.parameters, self._scenario.federation.aggregation
        uavs = np.array(sorted(arrived), dtype=np.intp)
        try:
            answer = self._rule.step(self._state, stacked(arrived), uavs, number)
            if not isinstance(answer, tuple) or len(answer) != 2:
                raise TypeError(f"`step` returns a {type(answer).__name__}; expected the state and the model")
            after, model = answer
            if np.shape(model) != (width,):
                raise ValueError(f"a model of shape {np.shape(model)}; expected ({width},)")
            model = np.asarray(model).astype(np.float64, casting="same_kind")
            if not np.isfinite(model).all():
                raise ValueError("the model is not finite")
            check_again("state", after, self._state)
            self._kept = _recorded(after)
        except FAILURES as error:
            self.complaints.append(f"aggregator {name!r} failed in round {number}: {last_line(error)}")
            return None
        self._state = after
        return model

    def _check(self, frames: Frames) -> None:
        if frames.kind != (FrameKind.UPLOAD if self._relay is None else FrameKind.RELAY):
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames are not for the leader")
        if self._relay is None:
            self._up.check(frames.payload, len(frames.source))
        else:
            self._relay.check_relays(frames.source, frames.payload)


def _recorded(state_: State) -> bytes:
    """What a rule remembers, as a record; nothing where it remembers nothing.

    Raises:
        TypeError, ValueError: it cannot be kept.
    """
    check_kept("state", state_)
    for name, array in state_.items():
        if not np.isfinite(array).all():
            raise ValueError(f"state[{name!r}] is not finite")
    if (size := sum(array.nbytes for array in state_.values())) > MAX_MEMORY_BYTES:
        raise ValueError(f"the state has {size} bytes; at most {MAX_MEMORY_BYTES}")
    return encode_record(state_) if state_ else b""
