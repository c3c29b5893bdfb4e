"""The progress bar of a flight, and the table at its end."""

import io
import re

import msgspec
import numpy as np
import pytest
from rich.console import Console

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.progress import FlightProgress, summary_table
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import SWARM_COLUMNS
from tests.groundstation.recordings import flight

FLOWN = load(None, ["uavs=2", "method=mfg", "duration=1", 'stop="duration"'])


@pytest.mark.parametrize("realtime", [100.0, None])
def test_the_line_and_the_table_have_late_commands_in_real_time_alone(realtime: float | None) -> None:
    bar = FlightProgress(FLOWN, quiet=True, console=Console(file=io.StringIO(), width=200))
    engine = Engine(FLOWN, "shown", sinks=[bar], realtime=realtime)
    for tick in engine.fly():
        if tick == 3 and realtime is not None:
            assert "held" not in str(bar._bar.tasks[0].fields["detail"])
            engine.world.counters.late(1234)
    line = str(bar._bar.tasks[0].fields["detail"])
    out = io.StringIO()
    Console(file=out, width=120).print(summary_table(engine.world.finish()))
    table = out.getvalue()
    assert "arrived" in line
    assert ("held 1234 in 1 late ticks" in line, "held" in line) == (realtime is not None, realtime is not None)
    for words in ("1,234", "deadline misses", "of 10 ticks", "tick starts late by, 99 %"):
        assert (words in table) == (realtime is not None)


@pytest.mark.parametrize("width", [60, 80, 160])
def test_no_number_is_cut_off_on_a_narrow_terminal(width: int) -> None:
    out = io.StringIO()
    terminal = Console(file=out, width=width, force_terminal=True, color_system=None)
    flown = load(None, ["uavs=25", "method=mfg"])
    with FlightProgress(flown, quiet=False, console=terminal) as bar:
        swarm = np.zeros((1, len(SWARM_COLUMNS)))
        for name, number in (("arrived", 21), ("uplink_bits", 12_345_678), ("held_commands", 1234)):
            swarm[:, SWARM_COLUMNS.index(name)] = number
        (block,) = flight(ticks=20)
        bar.write(msgspec.structs.replace(block, first_tick=2345, states=block.states[:1], swarm=swarm))
        bar._bar.refresh()
    lines = [line for line in re.split(r"[\r\n]|\x1b\[[0-9;?]*[A-Za-z]", out.getvalue()) if "flying" in line]
    assert lines
    for line in lines:
        assert "2345/3000 ticks" in line
        assert "234.5 s" in line
        assert "…" not in line
        assert len(line.rstrip()) <= width
        assert ("arrived 21/25" in line) == (width >= 80)
        assert ("held 1234 in 0 late ticks  12.35 Mbit" in line) == (width >= 160)


def test_there_is_no_bar_without_a_terminal() -> None:
    out = io.StringIO()
    with FlightProgress(FLOWN, quiet=False, console=Console(file=out, width=80)) as bar:
        bar.say("joining")
    assert out.getvalue() == ""
