"""An agent in nothing but `zenoh`, `msgpack` and `struct`, as docs/wire.md says, flies among ours, to the same bits."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.swarm import plugins
from meanflock.swarm.scenario import load
from tests.integration.conftest import Spawn
from tests.polling import DEADLINE_S

SPRING = Path(__file__).parents[2] / "examples" / "spring.py"
SETTINGS = ("method=spring", "uavs=3", "seed=5", "duration=30", 'stop="duration"', "radio.target_snr_db=77")
FOREIGN = 1  # the UAV that is not flown by us
AGENT = '''
"""A damped spring to the destination, away from whoever is heard: examples/spring.py in plain Python."""

import os, queue, struct, sys, time, zlib
import msgpack, zenoh

RUN, ENDPOINT, UAV = sys.argv[1], sys.argv[2], int(sys.argv[3])
STIFFNESS, DAMPING = 0.02, 0.3
SENSE, ACT, STATE, FLOAT32 = 1, 2, 2, 1
FINGERPRINT = zlib.crc32(RUN.encode())

def acceleration(x, y, vx, vy, heard):
    ax, ay = -STIFFNESS * x - DAMPING * vx, -STIFFNESS * y - DAMPING * vy
    for other_x, other_y in heard:
        dx, dy = x - other_x, y - other_y
        over = 1.0 + (dx * dx + dy * dy)
        ax, ay = ax + dx / (over * over), ay + dy / (over * over)
    return ax, ay

def byte_string(data):
    return struct.pack(">BI", 0xC6, len(data)) + data

def act(tick, command, state, memory):
    head = struct.pack(">BBBIBIBBIB", 0x9C, ACT, 0xCE, FINGERPRINT, 0xCE, tick, 0, 0xCE, 1, 2)
    table = byte_string(struct.pack("<2d", *command))
    lost = refused = models = byte_string(b"")
    frame = struct.pack(">BBBIBBI", 0x97, STATE, 0xCE, 0, FLOAT32, 0xCE, 4)
    frame += byte_string(struct.pack("<i", UAV)) + byte_string(struct.pack("<4f", *state)) + byte_string(b"")
    return head + table + lost + refused + models + byte_string(memory) + struct.pack(">BH", 0xDC, 1) + frame

def fly(raw):
    kind, run, tick, flags, rows, columns, table, memory, frames = msgpack.unpackb(raw)
    assert (kind, run, rows, columns) == (SENSE, FINGERPRINT, 1, 4)
    state = struct.unpack("<4d", table)
    heard = []
    for of, number, dtype, width, source, payload, links in frames:
        assert (of, dtype, width) == (STATE, FLOAT32, 4)
        for row, receiver in struct.iter_unpack("<2i", links):
            assert receiver == UAV
            heard.append(struct.unpack_from("<2f", payload, 16 * row))
    return act(tick, acceleration(*state, heard), state, b"\\x80" if flags & 2 else b"")

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", '["%s"]' % ENDPOINT)
config.insert_json5("connect/timeout_ms", "60000")
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
join = msgpack.packb(["join", "agent", 1, UAV, int.from_bytes(os.urandom(7), "little")])
welcome = None
while welcome is None:
    for reply in session.get("meanflock/%s/node/agent-%d/join" % (RUN, UAV), payload=join, timeout=2.0):
        if reply.ok is not None:
            welcome = msgpack.unpackb(reply.ok.payload.to_bytes())
    time.sleep(0.1)
tag, run, node, uavs, tick, scenario, plan, *_ = welcome
assert (tag, run, uavs) == ("welcome", FINGERPRINT, [UAV]), welcome
said = queue.SimpleQueue()
listening = session.declare_subscriber(
    "meanflock/%s/node/%s/sense" % (RUN, node), lambda sample: said.put(sample.payload.to_bytes())
)
alive = session.liveliness().declare_token("meanflock/%s/alive/agent/%s" % (RUN, node))
speak = session.declare_publisher(
    "meanflock/%s/node/%s/act" % (RUN, node), congestion_control=zenoh.CongestionControl.BLOCK, express=True
)
last, reply = -1, b""
while True:
    if last < 0:
        speak.put(msgpack.packb(["ready", FINGERPRINT]))
    try:
        raw = said.get(timeout=0.2)
    except queue.Empty:
        continue
    if raw[1] not in (SENSE, ACT):
        tag, run, reason, lost = msgpack.unpackb(raw)
        assert (tag, run, lost) == ("stop", FINGERPRINT, False)
        break
    tick = struct.unpack_from(">I", raw, 8)[0]
    if tick > last:
        last, reply = tick, fly(raw)
    speak.put(reply)  # the same tick again gets the same bytes
session.close()
strangers = {"numpy", "msgspec", "swarm", "agent", "kernels", "meanflock"} & set(sys.modules)
print(reason, last, sorted(strangers))
'''

pytestmark = pytest.mark.processes


def test_an_agent_of_another_language_flies_among_ours_to_the_same_bits(
    tmp_path: Path, spawn: Spawn, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = free_endpoint()
    (tmp_path / "agent.py").write_text(AGENT, encoding="utf-8")
    monkeypatch.setenv(plugins.FILES, str(SPRING))
    base = ("--run", "foreign", "--endpoint", endpoint, "--wait", str(int(DEADLINE_S)))
    world = spawn("worldsim", *base, *(flag for setting in SETTINGS for flag in ("--set", setting)))
    ours = [spawn("agent", *base, "--uav", str(uav)) for uav in range(3) if uav != FOREIGN]
    line = [sys.executable, "-I", str(tmp_path / "agent.py"), "foreign", endpoint, str(FOREIGN)]
    foreign = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert foreign.stdout.strip() == "finished 299 []", foreign.stderr
    out, err = world.communicate(timeout=DEADLINE_S)
    assert world.returncode == 0, err
    summary = json.loads(out)
    assert [process.wait(DEADLINE_S) for process in ours] == [0, 0]
    assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})

    plugins.load_file(SPRING)
    alone = Engine(load(None, SETTINGS), "foreign").complete()
    assert summary["trajectory_sha256"] == alone["trajectory_sha256"]
    assert summary["payload_bits"] == alone["payload_bits"]
    assert alone["radio"]["traffic"]["state"]["sent"] == 300 * 3 * 2
    assert alone["radio"]["traffic"]["state"]["outages"] > 0
