"""What the doctor finds on machines that lack something, each made up from a few files, and what it says to mend it."""

import os
import socket
import stat
from pathlib import Path

import pytest

from meanflock import kernels
from meanflock.groundstation import certs, doctor
from meanflock.groundstation.cli.command import main
from meanflock.groundstation.doctor import Finding
from meanflock.kernels import sources

NOT_RUNNING = "Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is the docker daemon running?"
DENIED = "permission denied while trying to connect to the Docker daemon socket at unix:///var/run/docker.sock"


@pytest.fixture
def docker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A `docker` that says what it is told to say; `version` and `compose`: what it prints, or complains where None."""
    monkeypatch.delenv("DOCKER_HOST", raising=False)

    def make(version: str | None, compose: str | None, complaint: str = NOT_RUNNING) -> None:
        answers = {"version": (version, complaint), "compose": (compose, "docker: 'compose' is not a docker command.")}
        cases = [
            f"{verb}) echo '{said}';;" if said is not None else f'{verb}) echo "{else_}" >&2; exit 1;;'
            for verb, (said, else_) in answers.items()
        ]
        script = tmp_path / "docker"
        script.write_text("#!/bin/sh\ncase $1 in\n" + "\n".join(cases) + "\nesac\n")
        script.chmod(script.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")

    return make


def test_an_engine_and_its_compose_plugin_are_found_with_their_versions(docker) -> None:
    docker("28.2.2", "2.26.1-4")
    assert doctor.engine() == [
        Finding("container engine", "ok", "version 28.2.2"),
        Finding("docker compose", "ok", "version 2.26.1-4"),
    ]


@pytest.mark.parametrize(
    ("complaint", "found", "mend"),
    [
        (NOT_RUNNING, "Is the docker daemon running?", "systemctl start docker"),
        (DENIED, "may not talk", "usermod -aG docker"),
    ],
)
def test_an_engine_out_of_reach_says_what_to_do(docker, complaint: str, found: str, mend: str) -> None:
    docker(None, "2.26.1", complaint)
    engine, compose = doctor.engine()
    assert engine.verdict == "warning"
    assert found in engine.found
    assert mend in engine.mend
    assert compose.verdict == "ok"


def test_an_engine_that_is_said_to_be_elsewhere_is_looked_for_there(docker, monkeypatch: pytest.MonkeyPatch) -> None:
    docker(None, "2.26.1")
    monkeypatch.setenv("DOCKER_HOST", "tcp://nowhere:2375")
    (engine, _) = doctor.engine()
    assert "tcp://nowhere:2375" in engine.found
    assert "DOCKER_HOST" in engine.mend


@pytest.mark.parametrize("version", [None, "1.29.2", "unknown"])
def test_a_compose_that_is_missing_or_too_old_is_not_good_enough(docker, version: str | None) -> None:
    docker("28.2.2", version)
    _, compose = doctor.engine()
    assert compose.verdict == "warning"
    assert "compose plugin, version 2" in compose.mend


def test_without_docker_only_the_containers_are_out_of_reach(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    (engine,) = doctor.engine()
    assert (engine.verdict, engine.found) == ("warning", "not found")
    assert "install" in engine.mend


def test_an_engine_that_never_answers_does_not_hold_up_the_doctor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "docker").write_text("#!/bin/sh\nexec sleep 600\n")
    (tmp_path / "docker").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    monkeypatch.delenv("DOCKER_HOST", raising=False)
    monkeypatch.setattr(doctor, "_ENGINE_S", 0.2)
    engine, compose = doctor.engine()
    assert "no answer" in engine.found
    assert compose.verdict == "warning"


# -- what a container is granted ------------------------------------------------------------------------------------


def group(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_", ".", 1)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def test_kernels_that_were_not_compiled_are_worth_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MEANFLOCK_PURE", raising=False)
    monkeypatch.setattr(kernels, "BACKEND", "compiled")
    assert doctor.compiled().verdict == "ok"
    monkeypatch.setattr(kernels, "BACKEND", "numpy")
    monkeypatch.setattr(sources, "built", lambda: False)
    assert doctor.compiled().verdict == "warning"
    assert "compiler" in doctor.compiled().mend
    monkeypatch.setattr(sources, "built", lambda: True)  # and yet not taken
    assert doctor.compiled().verdict == "warning"
    assert "other sources" in doctor.compiled().found
    assert "pip install" in doctor.compiled().mend
    monkeypatch.setenv("MEANFLOCK_PURE", "1")
    assert doctor.compiled().verdict == "ok"
    assert "MEANFLOCK_PURE" in doctor.compiled().found


def test_threads_beyond_the_limit_of_the_container_fail_with_the_number_it_takes(tmp_path: Path) -> None:
    group(tmp_path, pids_max="128", pids_current="28")
    assert doctor.threads(9, 1, tmp_path).verdict == "ok"
    tight = doctor.threads(10, 1, tmp_path)
    assert (tight.verdict, tight.found) == ("fails", "104 needed, 100 left")
    assert "132" in tight.mend
    assert doctor.threads(10, 10, tmp_path).verdict == "ok"


# -- ports and certificates -----------------------------------------------------------------------------------------


def test_a_port_in_use_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        taken = doctor._port("bus port", port, "end it")
    assert (taken.verdict, taken.found, taken.mend) == ("warning", f"{port}: Address already in use", "end it")
    assert doctor._port("bus port", port, "end it").verdict == "ok"


def test_a_folder_without_certificates_and_an_authority_that_expired_fail(tmp_path: Path) -> None:
    (missing,) = doctor.certificates(tmp_path / "nowhere", 1, 1)
    assert (missing.verdict, "No such file" in missing.found) == ("fails", True)
    assert "certs init" in missing.mend
    authority = certs.Authority("old", days=-2)
    authority.write(tmp_path)
    for name in certs.names(1):
        authority.issue(tmp_path, name, days=30)
    (expired,) = doctor.certificates(tmp_path, 1, 1)
    assert expired.verdict == "fails"
    assert f"{tmp_path / 'ca.pem'}: expired on" in expired.found


def test_the_key_that_can_make_anyone_is_nobody_elses_to_read(tmp_path: Path) -> None:
    folder = tmp_path / "certs"
    certs.init(folder, 1)
    (folder / "ca.key").chmod(0o640)
    (finding,) = doctor.certificates(folder, 1, 1)
    assert (finding.verdict, finding.mend) == ("warning", f"chmod 600 {folder / 'ca.key'}")
    (folder / "ca.key").rename(tmp_path / "in a safe place")
    assert [finding.verdict for finding in doctor.certificates(folder, 1, 1)] == ["ok"]


def test_the_verdicts_are_shown_and_a_failure_is_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    certs.init(tmp_path / "certs", 2)
    wide = ["doctor", "--uavs", "2", "--out", str(tmp_path), "--tls", str(tmp_path / "certs")]
    assert main(wide) == 0
    said = capsys.readouterr().out
    for what in ("threads", "bus port", "container engine", "certificates", "prometheus-client"):
        assert what in said
    (tmp_path / "certs" / "agent-1.pem").unlink()
    monkeypatch.setattr(doctor, "PACKAGES", ("no-such-package",))
    monkeypatch.setenv("COLUMNS", "200")
    assert main(wide) == 1
    said = capsys.readouterr().out
    assert "fails" in said
    assert "pip install 'meanflock[ground]'" in said
