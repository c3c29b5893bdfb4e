"""The findings of the doctor on machines that lack something, and the remedies it names."""

import os
import socket
from pathlib import Path

import pytest

from meanflock import kernels
from meanflock.groundstation import certs, doctor
from meanflock.groundstation.cli.command import main
from meanflock.groundstation.doctor import Finding
from meanflock.kernels import sources

NOT_RUNNING = "Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is the docker daemon running?"
DENIED = "permission denied while trying to connect to the Docker daemon socket at unix:///var/run/docker.sock"
COMPOSE = "compose plugin, version 2"


def docker(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    (folder / "docker").write_text(f"#!/bin/sh\n{script}\n")
    (folder / "docker").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}/usr/bin{os.pathsep}/bin")
    monkeypatch.delenv("DOCKER_HOST", raising=False)


def test_an_engine_and_its_compose_plugin_are_found_with_their_versions(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    (missing,) = doctor.engine()
    assert (missing.verdict, missing.found, "install" in missing.remedy) == ("warning", "not found", True)
    docker(tmp_path, monkeypatch, "case $1 in version) echo 28.2.2;; compose) echo 2.26.1-4;; esac")
    assert doctor.engine() == [
        Finding("container engine", "ok", "version 28.2.2"),
        Finding("docker compose", "ok", "version 2.26.1-4"),
    ]


@pytest.mark.parametrize(
    ("script", "host", "findings"),
    [
        (f"echo '{NOT_RUNNING}' >&2; exit 1", None, [("docker daemon running?", "systemctl start docker"), None]),
        (f"echo '{DENIED}' >&2; exit 1", None, [("may not talk", "usermod -aG docker"), None]),
        (f"echo '{NOT_RUNNING}' >&2; exit 1", "tcp://nowhere:2375", [("tcp://nowhere:2375", "DOCKER_HOST"), None]),
        ("exec sleep 600", None, [("no answer", ""), None]),
        ("case $1 in version) echo 28.2.2;; *) exit 1;; esac", None, [None, ("", COMPOSE)]),
        ("case $1 in version) echo 28.2.2;; *) echo 1.29.2;; esac", None, [None, ("", COMPOSE)]),
    ],
    ids=["not running", "denied", "elsewhere", "silent", "no compose", "old compose"],
)
def test_an_engine_that_cannot_be_used_is_a_warning_with_a_remedy(
    script, host, findings, tmp_path, monkeypatch
) -> None:
    docker(tmp_path, monkeypatch, script)
    monkeypatch.setattr(doctor, "_ENGINE_S", 0.2 if "sleep" in script else 30.0)
    if host is not None:
        monkeypatch.setenv("DOCKER_HOST", host)
    for finding, expected in zip(doctor.engine(), findings, strict=True):
        if expected is not None:
            found = (finding.verdict, expected[0] in finding.found, expected[1] in finding.remedy)
            assert found == ("warning", True, True)


def test_kernels_that_were_not_compiled_are_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "BACKEND", "numpy")
    monkeypatch.delenv("MEANFLOCK_PURE", raising=False)
    for built, words in ((False, "compiler"), (True, "pip install")):  # True: of other sources
        monkeypatch.setattr(sources, "built", lambda built=built: built)
        finding = doctor.compiled()
        assert (finding.verdict, words in finding.remedy) == ("warning", True)
    assert "other sources" in finding.found
    monkeypatch.setenv("MEANFLOCK_PURE", "1")
    assert (doctor.compiled().verdict, "MEANFLOCK_PURE" in doctor.compiled().found) == ("ok", True)
    monkeypatch.setattr(kernels, "BACKEND", "compiled")
    assert doctor.compiled().verdict == "ok"


def test_threads_beyond_the_limit_of_the_container_fail_with_the_number_that_is_needed(tmp_path: Path) -> None:
    (tmp_path / "pids.max").write_text("128")
    (tmp_path / "pids.current").write_text("28")
    assert doctor.threads(9, 1, tmp_path).verdict == "ok"
    tight = doctor.threads(10, 1, tmp_path)
    assert (tight.verdict, tight.found) == ("fails", "104 needed, 100 left")
    assert "132" in tight.remedy
    assert doctor.threads(10, 10, tmp_path).verdict == "ok"


def test_a_port_in_use_is_a_warning() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        taken = doctor._port("bus port", port, "end it")
    assert (taken.verdict, taken.found, taken.remedy) == ("warning", f"{port}: Address already in use", "end it")
    assert doctor._port("bus port", port, "end it").verdict == "ok"


def test_the_command_shows_all_verdicts_and_its_exit_code_is_that_of_a_run(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    certs.init(tmp_path / "certs", 2)
    line = ["doctor", "--uavs", "2", "--out", str(tmp_path), "--tls", str(tmp_path / "certs")]
    assert main(line) == 0
    said = capsys.readouterr().out
    checks = ("Python", "numpy", "memory", "threads", "loopback", "bus port", "output folder", "container engine")
    for check in (*checks, "certificates", "prometheus-client"):
        assert check in said
    (tmp_path / "certs" / "agent-1.pem").unlink()
    monkeypatch.setattr(doctor, "PACKAGES", ("no-such-package",))
    assert main(line) == 1
    said = capsys.readouterr().out
    assert "fails" in said
    assert "pip install 'meanflock[ground]'" in said
    assert main(["doctor", "--uavs", "9000"]) == 1
