"""Certificates: what `certs init` makes, and that `run` and `doctor` see what is amiss before a process starts."""

import json
import os
import stat
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from meanflock.cli.command import main

from meanflock.launch import certs
from meanflock.launch.doctor import certificates
from meanflock.net.access import Identity, only_agent, secured
from meanflock.swarm.errors import BadInput


@pytest.fixture(scope="module")
def issued(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "certs"
    certs.init(folder, 3)
    return folder


def test_there_is_a_certificate_and_a_private_key_for_everyone(issued: Path) -> None:
    wanted = ["ca", "world", "leader", "station", "observer", "agent-0", "agent-1", "agent-2"]
    files = {f"{name}.{kind}" for name in wanted for kind in ("pem", "key")}
    assert {path.name for path in issued.iterdir()} == {*files, certs.COMPOSE}
    assert {stat.S_IMODE(path.stat().st_mode) for path in issued.glob("*.key")} == {0o600}
    assert stat.S_IMODE(issued.stat().st_mode) == 0o700
    assert (issued / "ca.key").stat().st_uid == os.getuid()
    assert list(certs.problems(issued, certs.names(3))) == []
    assert Identity(issued, "agent-1").check().name == "agent-1"
    assert [finding.verdict for finding in certificates(issued, 3, 1)] == ["ok"]


def test_a_container_is_given_its_own_key_and_no_other(issued: Path) -> None:
    services = json.loads((issued / certs.COMPOSE).read_text())["services"]
    assert services.pop("agent") == {"deploy": {"replicas": 0}}
    assert services.pop("runs") == {"environment": {"RUNS_OWNER": services["groundstation"]["user"]}}
    own = {"worldsim": "world", "groundstation": "station"}
    assert set(services) == {"worldsim", "leader", "groundstation", "agent-0", "agent-1", "agent-2"}
    for name, service in services.items():
        files = ["ca.pem", f"{own.get(name, name)}.pem", f"{own.get(name, name)}.key"]
        given = [(v["source"], v["target"], v["read_only"]) for v in service["volumes"]]
        assert given == [(str(issued / file), f"/certs/{file}", True) for file in files]
        uid, _ = service["user"].split(":")
        assert int(uid) == (issued / files[2]).stat().st_uid != 0
    assert services["agent-1"]["profiles"] == ["secure"]


def test_keys_are_never_overwritten(issued: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (issued / "ca.key").read_bytes()
    assert main(["certs", "init", str(issued), "--uavs", "3"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {issued}")
    assert (issued / "ca.key").read_bytes() == before


def misname(folder: Path, authority: certs.Authority) -> None:
    authority.issue(folder, "agent-7")
    for kind in ("pem", "key"):
        (folder / f"agent-7.{kind}").rename(folder / f"agent-0.{kind}")


def mismatch(folder: Path, authority: certs.Authority) -> None:
    authority.issue(folder, "agent-0")
    (folder / "agent-0.key").write_bytes((folder / "leader.key").read_bytes())


BROKEN: dict[str, Callable[[Path, certs.Authority], object]] = {  # a part of the verdict on the agent's certificate
    "No such file": lambda folder, authority: None,
    "not signed by": lambda folder, authority: certs.Authority("two").issue(folder, "agent-0"),
    "expired on": lambda folder, authority: authority.issue(folder, "agent-0", days=-1),
    "CN=agent-7": misname,
    "does not fit": mismatch,
    "not a certificate": lambda folder, authority: (folder / "agent-0.pem").write_text("hello"),
}


@pytest.mark.parametrize("says", BROKEN)
def test_a_certificate_that_is_of_no_use_is_named_before_anything_starts(says: str, tmp_path, capsys) -> None:
    folder, authority = tmp_path / "certs", certs.Authority("one")
    folder.mkdir()
    authority.write(folder)
    for name in ("world", "leader", "station"):
        authority.issue(folder, name, hosts=certs.HOSTS if name == "world" else ())
    BROKEN[says](folder, authority)
    out = tmp_path / "runs"
    assert main(["run", "--uavs", "1", "--tls", str(folder), "--out", str(out), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert str(folder / "agent-0") in line
    assert says in line
    assert not out.exists()
    (finding,) = certificates(folder, 1, 1)
    assert finding.verdict == "fails"
    assert says in finding.found


def test_doctor_warns_of_keys_others_can_read_and_of_an_end_that_is_near(tmp_path: Path) -> None:
    folder = tmp_path / "certs"
    certs.init(folder, 1, days=3)
    (finding,) = certificates(folder, 1, 1)
    assert finding.verdict == "warning"
    (folder / "leader.key").chmod(0o644)
    (finding,) = certificates(folder, 1, 1)
    assert finding.verdict == "warning"
    assert finding.remedy == f"chmod 600 {folder / 'leader.key'}"
    (folder / "leader.key").chmod(0o600)
    (folder / "ca.key").rename(tmp_path / "in a safe place")
    assert [one.verdict for one in certificates(folder, 1, 1)] == ["warning"]
    (problem, *_) = certs.problems(folder, ["world"], at=datetime.now(UTC) + timedelta(days=4))
    assert "expired" in problem.reason


def test_an_agent_finds_its_own_key_if_it_is_the_only_one(issued: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--uav"):
        only_agent(issued)
    with pytest.raises(BadInput, match="--uav"):
        only_agent(tmp_path)
    (tmp_path / "agent-12.key").touch()
    assert only_agent(tmp_path) == 12


def test_an_endpoint_is_over_tls_exactly_if_there_are_certificates(issued: Path) -> None:
    me = Identity(issued, "leader")
    assert secured("tcp/127.0.0.1:7447", None) == "tcp/127.0.0.1:7447"
    assert secured("tcp/127.0.0.1:7447", me) == secured("tls/127.0.0.1:7447", me) == "tls/127.0.0.1:7447"
    with pytest.raises(BadInput, match="--tls"):
        secured("tls/127.0.0.1:7447", None)
    with pytest.raises(BadInput, match="--tls"):
        secured("unixsock-stream/world.socket", me)
    with pytest.raises(BadInput, match="the protocol must be one of tcp, tls, unixsock-stream"):
        secured("udp/127.0.0.1:7447", me)


def test_certificates_name_hosts_and_addresses_and_nothing_else(tmp_path: Path) -> None:
    for host in ("", "a b", "x;y", "größe.example", "-x", "a..b", "10.0.0.256/8"):
        with pytest.raises(BadInput, match="no name or address of a machine"):
            certs.init(tmp_path / "certs", 1, hosts=[host])
    assert not list(tmp_path.iterdir())
    certs.init(tmp_path / "certs", 1, hosts=["base", "base.example.org", "10.0.0.1", "fe80::1", "my_host-2", "*.lab"])
    certs.check(tmp_path / "certs", 1, 1)
