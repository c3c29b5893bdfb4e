"""The agent node: frames it receives, and rows that diverge. Frames that do not fit: tests/federation."""

import numpy as np
import pytest

from meanflock.agent.node import Agent
from meanflock.swarm import state
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Act
from tests.agent.nodes import flown, models, sense, states_at, welcome


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_a_row_that_diverges_is_silenced_for_good_and_reported_and_the_others_never_notice(method: str) -> None:
    of = flown(method=method)
    agent, honest, silent = Agent(welcome(of)), Agent(welcome(of)), []
    for tick in range(14):
        states = states_at(tick)
        if 3 <= tick < 12:  # the state returns, the row does not
            states[1] = [1e8, -1e8, 1e8, 1e8]
        act, expected = agent.act(sense(tick, states=states)), honest.act(sense(tick))
        assert isinstance(wire.read_act(wire.write_act(act)), Act)  # finite, whatever happens
        np.testing.assert_array_equal(act.commands[[0, 2]], expected.commands[[0, 2]])
        np.testing.assert_array_equal(models(act)[[0, 2]], models(expected)[[0, 2]])
        if len(act.lost):
            assert act.lost.tolist() == [3]
            assert not act.commands[1].any()
            assert not models(act)[1].any()
            silent.append([batch.source.tolist() for batch in act.outbox])
    assert act.lost.tolist() == [3], "it never diverged"
    assert all(3 not in source for said in silent[1:] for source in said)


def test_a_state_beyond_the_radio_s_floats_is_not_sent_and_the_others_are() -> None:
    """A half ends at 65504. The world would drop an Act with a number that is not finite."""
    agent = Agent(welcome(flown("radio.bits_per_float=16", "sharing.policy=tick", method="vasarhelyi")))
    agent.act(sense(0))  # the mission plan is in the place of its broadcast
    states = states_at(1)
    states[1, state.X] = 7e4
    with np.errstate(over="ignore"):
        act = agent.act(sense(1, states=states))
    assert isinstance(wire.read_act(wire.write_act(act)), Act)
    assert ([batch.source.tolist() for batch in act.outbox], len(act.lost)) == ([[2, 5]], 0)
