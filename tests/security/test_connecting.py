"""Only the nodes of a run can connect to it, and they fly as without TLS."""

import json
from pathlib import Path

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
from tests.security.conftest import ME, PATIENCE_S, RUN, VICTIM, Flight, Folders, forged

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


def test_a_client_without_a_certificate_of_a_node_of_this_run_can_do_nothing(
    flight: Flight, folders: Folders, undisturbed: str
) -> None:
    with pytest.raises(BusError):
        without_certificate(flight.endpoint, folders)
    for folder in (folders.foreign, folders.expired):
        with pytest.raises(BusError, match="refuses"):
            ZenohBus.client(flight.endpoint, PATIENCE_S, Identity(folder, ME))
    with pytest.raises(BusError):
        ZenohBus.client(flight.endpoint, PATIENCE_S)  # not even TLS
    stranger = flight.client("agent-99", folders.stranger)
    for key in (keys.telemetry(RUN), keys.sense(RUN, "*")):
        stranger.subscribe(key)
    stranger.put(keys.act(RUN, VICTIM), forged())
    assert stranger.ask(keys.join(RUN, "agent-99"), control.encode(Join("agent", 1, 99)), PATIENCE_S) is None
    summary = flight.land()
    assert stranger.receive(0.0) is None
    assert (summary["trajectory_sha256"], summary["lost"]) == (undisturbed, 0)


def test_no_node_can_pass_itself_off_as_the_world(folders: Folders) -> None:
    endpoint = free_endpoint()
    impostor = ZenohBus.router(endpoint, Identity(folders.good, ME))
    try:
        with pytest.raises(BusError):
            ZenohBus.client(endpoint, PATIENCE_S, Identity(folders.good, VICTIM))
    finally:
        impostor.close()


def test_the_command_flies_under_tls_as_without(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "certs")
    assert main(["certs", "init", folder, "--uavs", "4"]) == 0
    flown = ("--uavs", "4", "--seed", "7", "--duration", "10", "--set", "federation.period=20", "--no-record")
    summaries = []
    for flags in (("--tls", folder, "--uavs-per-process", "2"), ("--in-process",)):
        capsys.readouterr()
        assert main(["run", "--out", str(tmp_path / "runs"), "--json", "--quiet", *flown, *flags]) == 0
        summaries.append(json.loads(capsys.readouterr().out))
    assert summaries[0]["trajectory_sha256"] == summaries[1]["trajectory_sha256"]
    assert summaries[0]["dropped_messages"] == {}
