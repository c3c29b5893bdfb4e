"""Who has no certificate of a node of this run cannot connect, or nothing comes of it; who has one flies as without."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.swarm.errors import BusError
from meanflock.swarm.net import keys
from meanflock.swarm.net.access import Identity
from meanflock.swarm.net.address import secured
from meanflock.swarm.net.session import _COMMON, ZenohBus, _config
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Join
from tests.polling import DEADLINE_S
from tests.security.attacks import ME, PATIENCE_S, VICTIM, forged
from tests.security.conftest import RUN, Flight, Folders

pytestmark = pytest.mark.processes


def without_certificate(endpoint: str, folders: Folders) -> ZenohBus:
    """A client that believes the world's certificate and shows none."""
    settings = {
        **_COMMON,
        "mode": "client",
        "connect/endpoints": [secured(endpoint, Identity(folders.good, ME))],
        "connect/timeout_ms": int(PATIENCE_S * 1000),
        "connect/exit_on_failure": True,
        "transport/link/tls/root_ca_certificate": str(folders.good / "ca.pem"),
    }
    return ZenohBus(_config(settings))


def test_who_has_no_certificate_of_this_swarm_is_not_let_in(flight: Flight, folders: Folders, undisturbed: str) -> None:
    with pytest.raises(BusError):
        without_certificate(flight.endpoint, folders)
    with pytest.raises(BusError, match="refuses"):
        ZenohBus.client(flight.endpoint, PATIENCE_S, Identity(folders.foreign, ME))
    with pytest.raises(BusError, match="refuses"):
        ZenohBus.client(flight.endpoint, PATIENCE_S, Identity(folders.expired, ME))
    with pytest.raises(BusError):
        ZenohBus.client(flight.endpoint, PATIENCE_S)  # not even TLS
    summary = flight.land()
    assert summary["trajectory_sha256"] == undisturbed
    assert summary["lost"] == 0


def test_no_node_can_pass_itself_off_as_the_world(folders: Folders) -> None:
    endpoint = free_endpoint()
    impostor = ZenohBus.router(endpoint, Identity(folders.good, ME))
    try:
        with pytest.raises(BusError):
            ZenohBus.client(endpoint, PATIENCE_S, Identity(folders.good, VICTIM))
    finally:
        impostor.close()


def test_a_certificate_of_no_node_of_this_run_opens_nothing(flight: Flight, folders: Folders, undisturbed: str) -> None:
    stranger = flight.client("agent-99", folders.stranger)
    stranger.subscribe(keys.telemetry(RUN))
    stranger.subscribe(keys.sense(RUN, "*"))
    stranger.put(keys.act(RUN, VICTIM), forged())
    assert stranger.ask(keys.join(RUN, "agent-99"), control.encode(Join("agent", 1, 99)), PATIENCE_S) is None
    summary = flight.land()
    assert stranger.receive(0.0) is None
    assert summary["trajectory_sha256"] == undisturbed


# -- the commands ---------------------------------------------------------------------------------------------------


def test_the_command_flies_under_tls_as_without(tmp_path: Path) -> None:
    folder = tmp_path / "certs"

    def fly(*flags: str) -> dict[str, Any]:
        command = [
            sys.executable,
            "-m",
            "meanflock.groundstation.cli",
            "run",
            "--out",
            str(tmp_path / "runs"),
            "--json",
            "--quiet",
            "--no-record",
            *flags,
        ]
        command += ["--uavs", "4", "--seed", "7", "--duration", "10", "--set", "federation.period=20"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    assert main(["certs", "init", str(folder), "--uavs", "4"]) == 0
    secure = fly("--tls", str(folder))
    halves = fly("--tls", str(folder), "--uavs-per-process", "2")
    alone = fly("--in-process")
    assert secure["trajectory_sha256"] == halves["trajectory_sha256"] == alone["trajectory_sha256"]
    assert secure["dropped_messages"] == halves["dropped_messages"] == {}
