"""Answers told by their bytes, put together again as the message they would be."""

import numpy as np

from swarm.messages import Act
from swarm.scenario import Scenario
from worldsim.answers import Answers
from worldsim.members import Member

RUN, TICK = 0xC0FFEE42, 20


def read(of: Scenario, raw: bytes, by: Member, report: bool = False) -> Act | None:
    """What is told of an answer to that tick; None where nothing is."""
    answers = Answers(of, RUN)
    answers.open(TICK, report)
    if (answer := answers.read(by, raw)) is None:
        return None
    outcome, said, outbox = answer
    models = np.frombuffer(said).reshape(-1, 246) if said else None
    return Act(RUN, TICK, np.frombuffer(outcome).reshape(-1, 5), outbox=outbox, report=models)
