"""Modules that the process of an agent loads: as few as it needs, and all of them before it is forked."""

from tests.commands import loaded
from tests.sources import ROOT

# Not `hashlib`, `random`, `inspect`, `platform`: NumPy insists.
NEEDLESS = {
    *("dataclasses", "importlib.resources", "json", "shutil", "socket", "tempfile", "tomllib"),
    *("asyncio", "concurrent", "http", "multiprocessing", "ssl", "subprocess", "unittest", "xml", "zipfile"),
    *("numpy.ma", "numpy.fft", "numpy.polynomial", "numpy.testing", "numpy.f2py"),
}

# A life of an agent through a round, because a tick, an upload or a report might load more.
LIFE = """
import sys
import meanflock.agent.__main__
import numpy as np
from meanflock.agent.node import Agent
from meanflock.net import tick
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import FrameKind, Frames, Sense, Welcome

plan = np.arange(16, dtype="<f4").reshape(4, 4)
heard = Frames(FrameKind.STATE, 0, np.array([0, 2], "<i4"), plan[[0, 2]], np.array([[0, 1], [1, 1]], "<i4"))
for method, inbox in ((b"mfgfl-hf", ()), (b"hjb", (heard,))):
    scenario = b'{"method": "%s", "uavs": 4, "federation": ' % method
    scenario += b'{"period": 2, "fraction": 1.0, "payload": "int8", "fragment": 0}}'
    agent = Agent(control.decode(control.encode(Welcome(1, "agent-1", (1,), 0, scenario, plan))))
    acts = [agent.act(Sense(1, now, plan[1:2].astype("<f8"), True, True, inbox)) for now in range(5)]
    raw = [tick.write_act(act) for act in acts]
    assert sum(len(act.outbox) for act in acts) >= 2
"""


# Finding plug-ins loads parsers of packages, 2 MiB, which forked agents share.
FINDING = "import importlib.metadata"
FORKED = """
import meanflock.agent.__main__
from meanflock.launch import prefork

prefork._preload()
"""
PREPARED = """
from pathlib import Path
from meanflock.launch import forker

forker.prepare(Path({path!r}))
"""


def test_an_agent_loads_nothing_it_does_not_need_and_all_of_it_before_it_is_forked(tmp_path) -> None:
    flown = tmp_path / "int8.toml"
    flown.write_text('method = "mfgfl-hf"\n[federation]\npayload = "int8"\n', encoding="utf-8")
    prepared = PREPARED.format(path=str(flown))
    modules = loaded(LIFE, cwd=ROOT)
    assert {"numpy", "zenoh", "meanflock.swarm.scenario"} < modules
    assert sorted((modules & NEEDLESS) - loaded(FINDING, cwd=ROOT)) == []
    assert sorted(modules - loaded(FORKED, cwd=ROOT)) == []
    assert sorted(loaded(prepared + LIFE, cwd=ROOT) - loaded(prepared, cwd=ROOT)) == []
