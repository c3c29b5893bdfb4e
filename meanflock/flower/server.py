"""The ServerApp of a Flower app as an aggregation rule.

It gets the uploads of a round as replies, and what it sends next is the global model.
"""

from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import Meta

from meanflock.agent.learning.trees import ModelForm
from meanflock.agent.learning.worker import FIT_S, TRAININGS, Owner
from meanflock.federation.plan import topology_of
from meanflock.federation.rules.base import Aggregate, Aggregator, State, Uploads
from meanflock.federation.rules.base import Options as NoOptions
from meanflock.flower.app import FIRST_NODE, cast, joined
from meanflock.flower.client import FlowerClient, TrainingRequest, check_note
from meanflock.flower.grid import RunningServer
from meanflock.swarm.scenario import Scenario


class FlowerServer(Aggregator):
    """A ServerApp as an aggregation rule. `meanflock flower` makes a class of it for its app."""

    client: ClassVar[type[FlowerClient]]
    asked_void = True
    reports_metrics = True
    resumable = False

    class Options(NoOptions, frozen=True):
        """The options of the rule."""

        incomplete: Annotated[
            Literal["mean", "fill", "refuse"],
            Meta(
                description="of an upload that lost fragments: take their mean over the other uploads, take the global "
                "model's, or count it as a failure"
            ),
        ] = "mean"
        expires: Annotated[int, Meta(ge=1, description="rounds after which a message without a reply has failed")] = 1
        wait_s: Annotated[
            float, Meta(gt=0, le=FIT_S, description="wall time that the ServerApp may take in a round, s")
        ] = FIT_S

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        if (topology := topology_of(scenario)) != "leader":
            raise ValueError(f"a ServerApp needs a leader, and `federation.topology` is {topology}; leave that out")
        self._client_options = msgspec.convert(scenario.training.options, self.client.Options)
        self.note_bytes = self._client_options.note_bytes  # type: ignore[misc]
        self._server: RunningServer | None = None
        self._owner = Owner(runs_programs=self.client.runs_programs)

    def step(self, state: State, uploads: Uploads) -> tuple[State, Aggregate]:
        """See `Aggregator.step`. The ServerApp runs while no learner trains in this process: both use the global random
        generators."""
        aggregate: Aggregate = TRAININGS.call(lambda: self._answer(uploads), self._owner)
        return state, aggregate

    def _answer(self, uploads: Uploads) -> Aggregate:
        server = self._server or self._begin()
        if server.is_over:
            return Aggregate(None, done=True)
        asked = server.grid.asked  # the training that the replies answer
        assert asked is not None
        global_model, kept_bytes = self._form.split(cast(asked.arrays, self._first))
        for place, uav in enumerate(uploads.uavs.tolist()):
            note, arrived = uploads.notes[place], uploads.arrived[place]
            if len(note) < 2 or (self.options.incomplete == "refuse" and not arrived.all()):
                continue
            model = uploads.models[place]
            if self.options.incomplete == "fill":
                model = np.where(arrived, model, global_model)
            arrays: Any = self._form.join(model, kept_bytes)
            server.grid.reply(int.from_bytes(note[:2], "little"), FIRST_NODE + uav, joined(arrays, note[2:]))
        outcome = {"asked": float(len(asked.nodes)), "failures": float(server.grid.expire())}
        server.go_on(self.options.wait_s)
        metrics = server.grid.metrics | outcome
        if server.is_over:
            return Aggregate(None, done=True, metrics=metrics)
        wanted = server.grid.asked  # the next training
        assert wanted is not None
        note = TrainingRequest.of_asked(server.grid.number, wanted, self.scenario.uavs).note
        check_note("configuration", note, self.note_bytes)
        vector, _ = self._form.split(cast(wanted.arrays, self._first))
        return Aggregate(vector.astype(np.float64), note, metrics=metrics)

    def _begin(self) -> RunningServer:
        """Let the ServerApp run to its first message, which the UAVs have on board."""
        config = self.client.run_config(self._client_options)
        server = RunningServer(self.client.app, config, self.scenario.uavs, self.scenario.seed, self.options.expires)
        server.go_on(self.options.wait_s)
        assert server.grid.asked is not None
        self._first = server.grid.asked.arrays
        self._form = ModelForm(dict(self._first), self.scenario.training.integers, self.scenario.training.keeps)
        self._server = server
        return server
