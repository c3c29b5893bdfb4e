"""What a person sees: the line that moves, and the table at the end."""

import io
import re

import msgspec
import numpy as np
import pytest
from rich.console import Console

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.progress import FlightProgress, summary_table
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Telemetry
from tests.groundstation.recordings import flight

FLOWN = load(None, ["uavs=2", "method=mfg", "duration=1", 'stop="duration"'])


def shown(engine: Engine) -> str:
    summary = engine.world.finish()
    out = io.StringIO()
    Console(file=out, width=120).print(summary_table(summary))
    return out.getvalue()


class LastWords(FlightProgress):
    """Remembers the line instead of showing it."""

    def __init__(self) -> None:
        super().__init__(FLOWN, quiet=True, console=Console(file=io.StringIO(), width=200))

    @property
    def line(self) -> str:
        return str(self._bar.tasks[0].fields["detail"])


def test_commands_that_are_held_are_in_the_line_and_in_the_table() -> None:
    line = LastWords()
    engine = Engine(FLOWN, "shown", sinks=[line], realtime=100.0)
    for tick in engine.fly():
        if tick == 3:
            assert "held" not in line.line
            engine.world.counters.late(1234)
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


@pytest.mark.parametrize("width", [60, 80, 160])
def test_no_number_is_cut_off_on_a_narrow_terminal(width: int) -> None:
    out = io.StringIO()
    terminal = Console(file=out, width=width, force_terminal=True, color_system=None)
    flown = load(None, ["uavs=25", "method=mfg"])
    with FlightProgress(flown, quiet=False, console=terminal) as bar:
        swarm = np.zeros((1, len(SWARM_COLUMNS)))
        swarm[:, SWARM_COLUMNS.index("arrived")] = 21
        swarm[:, SWARM_COLUMNS.index("uplink_bits")] = 12_345_678
        swarm[:, SWARM_COLUMNS.index("held_commands")] = 1234
        (block,) = flight(ticks=20)
        bar.write(msgspec.structs.replace(block, first_tick=2345, states=block.states[:1], swarm=swarm))
        bar._bar.refresh()
    lines = [line for line in re.split(r"[\r\n]|\x1b\[[0-9;?]*[A-Za-z]", out.getvalue()) if "flying" in line]
    assert lines
    assert all("2345/3000 ticks" in line and "…" not in line and len(line.rstrip()) <= width for line in lines)
    assert all("234.5 s" in line for line in lines)
    assert all(("arrived 21/25" in line) == (width >= 80) for line in lines)
    assert all(("held 1234 in 0 late ticks  12.35 Mbit" in line) == (width >= 160) for line in lines)


def test_nothing_moves_where_there_is_no_terminal() -> None:
    out = io.StringIO()
    with FlightProgress(FLOWN, quiet=False, console=Console(file=out, width=80)) as bar:
        bar.say("joining")
    assert out.getvalue() == ""
