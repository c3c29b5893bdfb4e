"""A flight on processes that a raw client of MAVLink steers; one that nobody steers is the same."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from meanflock.cli.command import main
from meanflock.net.access import Address
from meanflock.swarm.errors import EXIT_DONE
from tests.bridge.client import Client, heartbeat, setpoint
from tests.faults.by_hand import Processes, Recorded
from tests.polling import DEADLINE_S, until

UAVS = 5
STEERED = 3  # the system; UAV 2
STRONG = 4.0  # m/s²


def ticks(client: Client, port: int, count: int, message: Any) -> dict[int, list[Any]]:
    """So many more positions of every vehicle; the message is sent before each look for them."""
    client.messages.clear()
    places: dict[int, list[Any]] = {}

    def enough() -> bool:
        client.send(port, message)
        client.receive()
        places.update((system, list(client.messages_of("LOCAL_POSITION_NED", system))) for system in range(1, UAVS + 1))
        return min(map(len, places.values())) >= count

    until(enough, f"{count} ticks")
    return places


def accelerations(places: list[Any]) -> list[float]:
    """Mean accelerations to the north between ticks."""
    return [
        1e3 * (after.vx - before.vx) / (after.time_boot_ms - before.time_boot_ms)
        for before, after in pairwise(places)
        if after.time_boot_ms > before.time_boot_ms
    ]


def steer_and_give_back(port: int) -> None:
    """Steer one vehicle to the north; only it speeds up, and after a second of silence it does so no longer."""
    with Client() as client:
        ticks(client, port, 3, heartbeat())
        pushed = ticks(client, port, 12, setpoint(STEERED, north=STRONG))
        for system, places in pushed.items():
            gain = sum(accelerations(places)[3:]) / max(1, len(accelerations(places)[3:]))
            assert (gain > 0.5 * STRONG) == (system == STEERED), (system, gain)
        for message in (setpoint(200, 1.0), setpoint(STEERED, mask=0), setpoint(STEERED, frame=8), b"\xfd\x00nothing"):
            client.send(port, message)
        back = ticks(client, port, 25, heartbeat())[STEERED]
        assert max(accelerations(back)[-5:]) < 0.5 * STRONG


@pytest.mark.processes
def test_only_the_addressed_uav_is_steered_until_its_client_falls_silent(processes: Processes, tmp_path: Path) -> None:
    port = Address("127.0.0.1", 0).free("--steer", datagrams=True).port
    line = ["run", "--realtime", "--steer", port, "--uavs", UAVS, "--duration", 20, "--no-record", "--json"]
    flight = processes.start("cli", *map(str, [*line, "--out", tmp_path]), base=())
    steer_and_give_back(port)
    out, said = flight.communicate(timeout=DEADLINE_S)
    assert flight.returncode == 0, said
    assert f"MAVLink clients steer at udp 127.0.0.1:{port}" in said
    summary = json.loads(out)
    assert summary["steered"]["uav_ticks"] >= 10
    assert summary["steered"]["replayable"] is False
    assert (summary["lost"], summary["realtime"]["factor"]) == (0, 1.0)
    assert summary["real_time_factor"] == pytest.approx(20.0 / summary["wall_time_s"])
    assert 20.0 <= summary["wall_time_s"] < DEADLINE_S  # a busy machine may be late
    expected = {"malformed": 1, "unknown-system": 1, "wrong-frame": 1, "wrong-mask": 1}
    assert {reason: summary["dropped_messages"].get(reason) for reason in expected} == expected
    flown = Recorded(tmp_path)
    (steered,), (released,) = flown.events("steered"), flown.events("released")
    assert steered["uavs"] == released["uavs"] == [STEERED - 1]
    assert steered["tick"] < released["tick"]
    assert sum("steering from" in event["text"] for event in flown.events("dropped")) == 4


def test_a_flight_that_nobody_steers_is_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["run", "--in-process", "--uavs", "2", "--duration", "2", "--quiet", "--no-record", "--json"]
    summaries = []
    for more in ([], ["--realtime", "100", "--steer", "0"]):
        assert main([*line, *more, "--out", str(tmp_path)]) == EXIT_DONE
        summaries.append(json.loads(capsys.readouterr().out))
    assert summaries[0]["trajectory_sha256"] == summaries[1]["trajectory_sha256"]
    assert [summary["steered"] for summary in summaries] == [None, {"uav_ticks": 0, "replayable": True}]


def test_the_code_of_the_page_pushes_uav_2_to_the_north() -> None:
    page = Path(__file__).parents[2] / "docs" / "mavlink.md"
    (code,) = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    with Client() as client:
        exec(code.replace("14540", str(client.port)), {})
        client.receive()
        (message,) = client.messages_of("SET_POSITION_TARGET_LOCAL_NED", 250)
    expected = setpoint(STEERED, north=2.0)
    assert message.to_dict() == expected.to_dict()
