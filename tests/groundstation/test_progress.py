"""What a person sees: the line that moves, and the table at the end."""

import io

import numpy as np
from rich.console import Console

from groundstation.engine import Engine
from groundstation.progress import FlightProgress, summary_table
from swarm.messages import Telemetry
from swarm.scenario import load

FLOWN = load(None, ["uavs=2", "method=mfg", "duration=1", 'stop="duration"'])


def shown(engine: Engine) -> str:
    summary = engine.world.finish()
    out = io.StringIO()
    Console(file=out, width=120).print(summary_table(summary))
    return out.getvalue()


class LastWords(FlightProgress):
    """Remembers the line instead of showing it."""

    def __init__(self) -> None:
        super().__init__(FLOWN, quiet=True)

    @property
    def line(self) -> str:
        return str(self._bar.tasks[0].fields["detail"])


def test_commands_that_are_held_are_in_the_line_and_in_the_table() -> None:
    line = LastWords()
    engine = Engine(FLOWN, "shown", sinks=[line], realtime=100.0)
    for tick in engine.fly():
        if tick == 3:
            assert "held" not in line.line
            engine.world.instruments.ledger.late(1234)
    table = shown(engine)
    assert "held 1234 in 1 late ticks" in line.line
    assert "1,234" in table
    assert "deadline misses" in table
    assert "of 10 ticks" in table
    assert "tick starts late by, 99 %" in table


def test_in_lockstep_neither_says_a_word_of_it() -> None:
    line = LastWords()
    blocks: list[Telemetry] = []

    class Keep:
        def write(self, block: Telemetry) -> None:
            blocks.append(block)

    engine = Engine(FLOWN, "shown", sinks=[line, Keep()])
    for _ in engine.fly():
        pass
    table = shown(engine)
    assert "held" not in line.line
    assert "arrived" in line.line
    assert "deadline misses" not in table
    assert not np.concatenate([block.swarm for block in blocks])[:, -2:].any()
