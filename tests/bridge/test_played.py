"""A recorded run as MAVLink vehicles: every sample is a state that was flown, at its time."""

from itertools import pairwise

import numpy as np
import pytest

import meanflock as mf
from meanflock.bridge.mavlink import Home
from meanflock.bridge.vehicles import Vehicles, play
from meanflock.cli.command import main
from meanflock.net.access import Address
from meanflock.results.flown import FlightSoFar
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.bridge.client import Client

KILL = {"kind": "kill", "time_s": 1.0, "uavs": [2]}
ACTIVE, EMERGENCY = 4, 6


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> mf.Run:
    return mf.fly("paper", uavs=5, duration=4, seed=7, faults=[KILL], out=tmp_path_factory.mktemp("flown"))


def test_every_sample_is_the_state_of_the_tick_of_its_time_stamp(flown: mf.Run) -> None:
    now = [100.0]  # of a clock that only sleep moves
    with Client() as client:

        def sleep(seconds: float) -> None:
            client.receive()
            now[0] += seconds

        to = [Address("127.0.0.1", client.port)]
        with Vehicles(5, flown.scenario.dt, to, Home(47.0, 8.0, 488.0), lambda: now[0]) as vehicles:
            play(FlightSoFar(flown.folder), vehicles, 2.0, lambda: now[0], sleep)
        client.receive()
    ticks = len(flown.states)
    assert now[0] - 100.0 == pytest.approx((ticks - 1) * flown.scenario.dt / 2.0)
    for uav in range(5):
        places = list(client.messages_of("LOCAL_POSITION_NED", uav + 1))
        assert [place.time_boot_ms for place in places] == [round(1e3 * k * flown.scenario.dt) for k in range(ticks)]
        said = np.array([(place.y, place.x, place.vy, place.vx) for place in places], dtype=np.float32)
        assert said.tobytes() == flown.states[:, uav].astype(np.float32).tobytes()
        assert {(place.z, place.vz) for place in places} == {(0.0, 0.0)}
        late = EMERGENCY if uav == 2 else ACTIVE
        assert [beat.system_status for beat in client.messages_of("HEARTBEAT", uav + 1)] == [ACTIVE, late, late]
        sequence = [message.get_seq() for message in client.messages if message.get_srcSystem() == uav + 1]
        assert all((after - before) % 256 == 1 for before, after in pairwise(sequence))


def test_global_positions_lie_about_the_home(flown: mf.Run) -> None:
    home = Home(60.0, 8.0, 488.0)  # a degree of longitude is half as long there
    with Client() as client:
        with Vehicles(1, 0.1, [Address("127.0.0.1", client.port)], home) as vehicles:
            vehicles.send(7, np.array([[1000.0, -2000.0, 3.0, -4.0]]), np.zeros(1))
        client.receive()
    (place,) = client.messages_of("GLOBAL_POSITION_INT")
    metres = np.pi * 6_371_000.0 / 180.0
    assert (place.lat / 1e7 - 60.0) * metres == pytest.approx(-2000.0, abs=0.02)
    assert (place.lon / 1e7 - 8.0) * metres / 2.0 == pytest.approx(1000.0, abs=0.02)
    assert (place.time_boot_ms, place.alt, place.relative_alt) == (700, 488_000, 0)
    assert (place.vx, place.vy, place.vz) == (-400, 300, 0)
    assert place.hdg / 100 == pytest.approx(90.0 + np.degrees(np.arctan2(4.0, 3.0)), abs=0.01)


def test_positions_in_space_are_above_the_home() -> None:
    with Client() as client:
        with Vehicles(1, 0.1, [Address("127.0.0.1", client.port)], Home(60.0, 8.0, 488.0)) as vehicles:
            vehicles.send(0, np.array([[10.0, -20.0, 30.5, 3.0, -4.0, 1.25]]), np.zeros(1))
        client.receive()
    (place,) = client.messages_of("LOCAL_POSITION_NED")
    assert (place.x, place.y, place.z, place.vx, place.vy, place.vz) == (-20.0, 10.0, -30.5, -4.0, 3.0, -1.25)
    (place,) = client.messages_of("GLOBAL_POSITION_INT")
    assert (place.alt, place.relative_alt, place.vz) == (518_500, 30_500, -125)


def test_the_first_station_is_the_home_of_every_vehicle() -> None:
    with Client() as client:
        to = [Address("127.0.0.1", client.port)]
        with Vehicles(2, 0.1, to, Home(60.0, 8.0, 488.0), lambda: 0.0, base=(1000.0, -2000.0, 25.0)) as vehicles:
            for tick in range(3):  # less than a second
                vehicles.send(tick, np.zeros((2, 4)), np.zeros(2))
        client.receive()
    assert not list(client.messages_of("HOME_POSITION", 3))
    for system in (1, 2):
        (place,) = client.messages_of("HOME_POSITION", system)
        metres = np.pi * 6_371_000.0 / 180.0
        assert (place.latitude / 1e7 - 60.0) * metres == pytest.approx(-2000.0, abs=0.02)
        assert (place.longitude / 1e7 - 8.0) * metres / 2.0 == pytest.approx(1000.0, abs=0.02)
        assert (place.altitude, place.x, place.y, place.z) == (513_000, -2000.0, 1000.0, -25.0)


def test_uavs_without_a_system_id_are_left_out() -> None:
    with Client() as client:
        with Vehicles(300, 0.1, [Address("127.0.0.1", client.port)], Home(0.0, 0.0)) as vehicles:
            vehicles.send(0, np.zeros((300, 4)), np.zeros(300))
        client.receive()
    assert vehicles.count == 255
    assert client.systems() == set(range(1, 256))


def test_the_command_plays_a_run(flown: mf.Run, capsys: pytest.CaptureFixture[str]) -> None:
    with Client() as client:
        to = ["--to", str(client.port), "--to", "127.0.0.1:9"]  # nobody listens at the second
        assert main(["bridge", "mavlink", str(flown.folder), "--speed", "1000", *to]) == EXIT_DONE
        client.until_found(5)
    assert capsys.readouterr().err == f"systems 1 to 5, by UDP to 127.0.0.1:{client.port}, 127.0.0.1:9\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "name the folder of a run, or --live ENDPOINT"),
        (["RUN", "--live", "tcp/127.0.0.1:7447"], "name the folder of a run, or --live ENDPOINT"),
        (["nowhere"], "no run"),
        *((["RUN", "--speed", text], "--speed") for text in ("0", "-1", "nan", "inf", "1e400")),
        *((["--live", "tcp/127.0.0.1:1", "--wait", text], "--wait") for text in ("nan", "inf", "-1")),
        (["RUN", "--to", "here"], "--to here"),
        (["RUN", "--to", "no.such.host.invalid:14550"], "--to no.such.host.invalid:14550"),
        *((["RUN", "--home", home], f"--home {home}: ") for home in ("91,0", "47,181", "nan,8", "47", "47,8,high", "")),
        (["RUN", "--home", "47,8,488,1"], "--home 47,8,488,1: "),
        (["RUN", "--tls", "certs"], "--tls certs: a recorded run has no links"),
        (["--live", "tcp/127.0.0.1:1", "--speed", "2"], "--speed 2: a live flight has its own"),
        (["--live", "here"], "endpoint here"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, said, flown: mf.Run, capsys) -> None:
    line = [str(flown.folder) if word == "RUN" else word for word in arguments]
    assert main(["bridge", "mavlink", *line]) == EXIT_BAD_INPUT
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert said in err
