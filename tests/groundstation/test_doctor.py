"""The doctor's findings on machines that lack something; memory and disk space that are needed, granted and refused."""

import os
import shutil
import socket
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

import meanflock as mf
from meanflock import kernels
from meanflock.groundstation import certs, disk, doctor
from meanflock.groundstation.cli.command import main
from meanflock.groundstation.disk import LARGE_SWARM
from meanflock.groundstation.doctor import Finding
from meanflock.groundstation.memory import MEGABYTE, available_mb, needed_mb
from meanflock.kernels import sources
from meanflock.swarm.scenario import load
from tests.faults.conftest import scenario
from tests.faults.dying import dead

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


MACHINE = psutil.virtual_memory().total // MEGABYTE


def group(root: Path, path: str, *, version: int, limit: str, used_mb: int, cache_mb: int = 0) -> None:
    """A control group as the kernel shows it."""
    folder = root / ("sys/fs/cgroup" if version == 2 else "sys/fs/cgroup/memory") / path
    folder.mkdir(parents=True, exist_ok=True)
    names = ("memory.max", "memory.current") if version == 2 else ("memory.limit_in_bytes", "memory.usage_in_bytes")
    reclaimable = "inactive_file" if version == 2 else "total_inactive_file"
    (folder / names[0]).write_text(f"{limit}\n")
    (folder / names[1]).write_text(f"{used_mb * MEGABYTE}\n")
    (folder / "memory.stat").write_text(f"anon 17\n{reclaimable} {cache_mb * MEGABYTE}\nactive_file 5\n")


def member_of(root: Path, *lines: str) -> None:
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/self/cgroup").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("version", "limit"), [(None, ""), (2, "max"), (1, str(2**63 - 4096)), (2, "soon")], ids=lambda value: str(value)
)
def test_without_a_limit_the_memory_is_that_of_the_machine(tmp_path: Path, version: int | None, limit: str) -> None:
    if version is not None:
        member_of(tmp_path, "0::/run" if version == 2 else "3:memory:/run")
        group(tmp_path, "run", version=version, limit=limit, used_mb=7)
    available, limit_name = available_mb(tmp_path)
    assert 0 < available <= MACHINE
    assert limit_name == "available"


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("limited", ["pod/run", "pod", ""])
def test_the_tightest_limit_of_all_groups_counts_without_reclaimable_cache(tmp_path, version, limited) -> None:
    member_of(tmp_path, "5:cpu,memory:/pod/run" if version == 1 else "0::/pod/run")
    group(tmp_path, "pod/run", version=version, limit=str(2**42), used_mb=10)
    group(tmp_path, limited, version=version, limit=str(64 * MEGABYTE), used_mb=50, cache_mb=20)
    assert available_mb(tmp_path) == (34, "left of this container's limit")


@pytest.mark.parametrize(("used_mb", "left_mb"), [(16, 32), (49, 0)])
def test_a_container_that_does_not_see_its_group_uses_the_mounted_one(tmp_path, used_mb: int, left_mb: int) -> None:
    member_of(tmp_path, "3:memory:/docker/0123456789ab", "0::/docker/0123456789ab")  # the path on the host
    group(tmp_path, "", version=1, limit=str(48 * MEGABYTE), used_mb=used_mb)
    assert available_mb(tmp_path)[0] == left_mb


@pytest.mark.parametrize(
    ("left_mb", "processes", "verdict", "remedy"),
    [(10**6, 200, "ok", ""), (1000, 200, "fails", "--uavs-per-process 25"), (100, 0, "fails", "--uavs N")],
)
def test_the_doctor_compares_the_need_and_names_a_remedy(monkeypatch, left_mb, processes, verdict, remedy) -> None:
    monkeypatch.setattr(doctor, "available_mb", lambda: (left_mb, "left of this container's limit"))
    found = doctor.memory(200, processes)
    assert found.verdict == verdict
    assert f"{needed_mb(200, processes)} MB for 200 UAVs" in found.found
    assert f"{left_mb} MB left of this container's limit" in found.found
    assert remedy in found.remedy


@pytest.mark.parametrize("processes", [0, 4])
def test_a_method_whose_memory_grows_with_pairs_is_refused_with_the_largest_swarm_that_fits(
    monkeypatch: pytest.MonkeyPatch, processes: int
) -> None:
    monkeypatch.setattr(doctor, "available_mb", lambda: (8000, "available"))
    found = doctor.memory(10_000, processes, keeps_states=True)
    assert (found.verdict, "grows with N²" in found.remedy) == ("fails", True)
    most = int(found.remedy.split("--uavs ")[1].split(",")[0])
    assert 1000 < most < 10_000
    fits = [doctor.memory(uavs, processes and -(-uavs // 2500), keeps_states=True) for uavs in (most, most + 10)]
    assert [one.verdict for one in fits] == ["ok", "fails"]


@pytest.mark.parametrize("uavs", [25, LARGE_SWARM + 1])
def test_a_run_folder_takes_no_more_than_the_estimate_and_a_large_recording_is_announced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], uavs: int
) -> None:
    settings = [f"uavs={uavs}", "stop=duration", "duration=40", "federation.period=50"]
    flags = [word for setting in settings for word in ("--set", setting)]
    assert main(["run", "--in-process", "--out", str(tmp_path), *flags]) == 0
    told = "positions of every 5th tick" in capsys.readouterr().err
    assert told == (uavs > LARGE_SWARM)
    flown, size = load(None, settings), sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    assert size <= disk.needed_mb(flown, record=True) * 1e6 <= 2 * size + 4e6


@pytest.mark.parametrize(
    ("free_mb", "flags", "remedy"),
    [
        (80, (), "fly without the recording: --no-record"),
        (40, (), "a shorter flight: --duration S"),
        (40, ("--no-record",), "--out DIR"),
    ],
)
def test_a_run_that_would_not_fit_on_the_disk_is_refused_with_the_estimate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, free_mb, flags, remedy
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free_mb * 10**6))
    folder = tmp_path / "new" / "runs"
    assert main(["run", "--in-process", "--uavs", "200", "--out", str(folder), *flags]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    most = disk.needed_mb(load(None, ["uavs=200"]), record=not flags)
    assert line.startswith(f"error: disk: up to {most} MB for 200 UAVs over ")
    assert f"{free_mb} MB free" in line
    assert remedy in line
    assert not folder.parent.exists()


def test_a_flight_in_python_that_would_not_fit_is_refused_in_its_words(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=80 * 10**6))
    with pytest.raises(mf.BadInput, match="80 MB free; fly without the recording: record=False"):
        mf.fly(uavs=200, out=tmp_path / "new", record=True)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    with pytest.raises(mf.BadInput, match=r"0 MB free; a shorter flight: duration=S; or .*: out=DIR"):
        mf.fly(uavs=2, duration=1, out=tmp_path / "new")
    assert not (tmp_path / "new").exists()
    assert mf.fly(uavs=2, duration=1).summary["uavs"] == 2  # writes nothing


def test_a_run_is_resumed_only_if_the_rest_of_it_fits(tmp_path, capsys, monkeypatch) -> None:
    flown = scenario("duration=1000", "stop=duration", "uavs=50")
    folder, whole = dead(tmp_path, flown, 1500), disk.needed_mb(flown, record=False)
    most = disk.needed_mb(flown, record=False, flown=1500)
    assert most < whole
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=(most - 1) * 10**6))
    before = sorted(folder.iterdir())
    assert main(["resume", str(folder), "--in-process", "--no-record"]) == 2
    assert f"{most - 1} MB free; make room on its disk" in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before
