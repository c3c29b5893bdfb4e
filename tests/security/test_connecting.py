"""Links under TLS: only to the world, and nodes fly as without TLS. Other attacks: test_identity.py."""

import json
from pathlib import Path

import pytest

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.swarm.errors import BusError
from meanflock.swarm.net.access import Identity
from meanflock.swarm.net.session import ZenohBus
from tests.security.conftest import ME, PATIENCE_S, VICTIM, Folders

pytestmark = pytest.mark.processes


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
