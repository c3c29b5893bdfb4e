"""An agent without meanflock: spring.py in plain Python, with `zenoh`, `msgpack` and `struct`, as docs/wire.md says.

Run it with the name of the run, the endpoint of the world and the number of the UAV:

    python examples/foreign_agent.py swarm tcp/127.0.0.1:7447 1
"""

import os
import queue
import struct
import sys
import time
import zlib

import msgpack
import zenoh

RUN, ENDPOINT, UAV = sys.argv[1], sys.argv[2], int(sys.argv[3])
STIFFNESS, DAMPING = 0.02, 0.3
SENSE, ACT, STATE, FLOAT32 = 1, 2, 2, 1
FINGERPRINT = zlib.crc32(RUN.encode())


def acceleration(x, y, vx, vy, received):
    ax, ay = -STIFFNESS * x - DAMPING * vx, -STIFFNESS * y - DAMPING * vy
    for other_x, other_y in received:
        dx, dy = x - other_x, y - other_y
        over = 1.0 + (dx * dx + dy * dy)
        ax, ay = ax + dx / (over * over), ay + dy / (over * over)
    return ax, ay


def byte_string(data):
    return struct.pack(">BI", 0xC6, len(data)) + data


def act(tick, command, state, memory):
    head = struct.pack(">BBBIBIBBIB", 0x9E, ACT, 0xCE, FINGERPRINT, 0xCE, tick, 0, 0xCE, 1, 2)
    table = byte_string(struct.pack("<2d", *command))
    nothing = byte_string(b"")  # no UAV lost, none refused, none waiting, no models
    frame = struct.pack(">BBBIBBI", 0x97, STATE, 0xCE, 0, FLOAT32, 0xCE, 4)
    frame += byte_string(struct.pack("<i", UAV)) + byte_string(struct.pack("<4f", *state)) + byte_string(b"")
    return head + table + 5 * nothing + byte_string(memory) + struct.pack(">BH", 0xDC, 1) + frame


def fly(raw):
    kind, run, tick, flags, rows, columns, table, _, frames = msgpack.unpackb(raw)
    assert (kind, run, rows, columns) == (SENSE, FINGERPRINT, 1, 4)
    state = struct.unpack("<4d", table)
    received = []
    for label, _, dtype, width, _, payload, links in frames:
        assert (label, dtype, width) == (STATE, FLOAT32, 4)
        for row, receiver in struct.iter_unpack("<2i", links):
            assert receiver == UAV
            received.append(struct.unpack_from("<2f", payload, 16 * row))
    return act(tick, acceleration(*state, received), state, b"\x80" if flags & 2 else b"")


config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{ENDPOINT}"]')
config.insert_json5("connect/timeout_ms", "60000")
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
join = msgpack.packb(["join", "agent", 1, UAV, int.from_bytes(os.urandom(7), "little")])
welcome = None
while welcome is None:
    for reply in session.get(f"meanflock/{RUN}/node/agent-{UAV}/join", payload=join, timeout=2.0):
        if reply.ok is not None:
            welcome = msgpack.unpackb(reply.ok.payload.to_bytes())
    time.sleep(0.1)
tag, run, node, uavs, tick, scenario, plan, *_ = welcome
assert (tag, run, uavs) == ("welcome", FINGERPRINT, [UAV]), welcome
requests = queue.SimpleQueue()
listening = session.declare_subscriber(
    f"meanflock/{RUN}/node/{node}/sense", lambda sample: requests.put(sample.payload.to_bytes())
)
alive = session.liveliness().declare_token(f"meanflock/{RUN}/alive/agent/{node}")
replies = session.declare_publisher(
    f"meanflock/{RUN}/node/{node}/act", congestion_control=zenoh.CongestionControl.BLOCK, express=True
)
last, reply = -1, b""
while True:
    if last < 0:
        replies.put(msgpack.packb(["ready", FINGERPRINT]))
    try:
        raw = requests.get(timeout=0.2)
    except queue.Empty:
        continue
    if raw[1] not in (SENSE, ACT):
        tag, run, reason, lost = msgpack.unpackb(raw)
        assert (tag, run, lost) == ("stop", FINGERPRINT, False)
        break
    tick = struct.unpack_from(">I", raw, 8)[0]
    if tick > last:
        last, reply = tick, fly(raw)
    replies.put(reply)  # the same tick again gets the same bytes
session.close()
print(reason, last)
