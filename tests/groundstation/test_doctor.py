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
from meanflock.cli.command import main
from meanflock.kernels import sources
from meanflock.launch import certs, doctor, memory
from meanflock.launch.memory import MEGABYTE, PAIR_BYTES, available_mb, needed_mb
from meanflock.results import disk
from meanflock.results.disk import LARGE_SWARM
from meanflock.swarm.scenario import load
from tests.faults.conftest import scenario
from tests.faults.dying import dead

NOT_RUNNING = "Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is the docker daemon running?"
DENIED = "permission denied while trying to connect to the Docker daemon socket at unix:///var/run/docker.sock"
COMPOSE = "compose plugin, version 2"


@pytest.mark.parametrize(
    ("script", "host", "findings"),  # of each finding: verdict, and words of what is found and of the remedy
    [
        (None, None, [("warning", "not found", "install")]),
        ("case $1 in version) echo 28.2.2;; *) echo 2.26.1-4;; esac", None, [("ok", "28.2.2"), ("ok", "2.26.1-4")]),
        (f"echo '{NOT_RUNNING}' >&2; exit 1", None, [("warning", "docker daemon running?", "systemctl start docker")]),
        (f"echo '{DENIED}' >&2; exit 1", None, [("warning", "may not talk", "usermod -aG docker")]),
        (f"echo '{NOT_RUNNING}' >&2; exit 1", "tcp://no:2375", [("warning", "tcp://no:2375", "DOCKER_HOST")]),
        ("exec sleep 600", None, [("warning", "no answer", "")]),
        ("case $1 in version) echo 28.2.2;; *) exit 1;; esac", None, [("ok", "28.2.2"), ("warning", "", COMPOSE)]),
        ("case $1 in version) echo 28.2.2;; *) echo 1.29.2;; esac", None, [("ok", "28.2.2"), ("warning", "", COMPOSE)]),
    ],
    ids=["none", "both", "not running", "denied", "elsewhere", "silent", "no compose", "old compose"],
)
def test_a_container_engine_is_ok_or_a_warning_with_a_remedy(script, host, findings, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("DOCKER_HOST", raising=False)
    if script is not None:
        (tmp_path / "docker").write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / "docker").chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
        monkeypatch.setattr(doctor, "_ENGINE_S", 0.2 if "sleep" in script else 30.0)
    if host is not None:
        monkeypatch.setenv("DOCKER_HOST", host)
    engine = doctor.engine()
    assert len(engine) == (1 if script is None else 2)
    for finding, (verdict, found, *remedy) in zip(engine, findings, strict=False):
        assert finding.verdict == verdict
        assert found in finding.found
        assert all(word in finding.remedy for word in remedy)


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


def test_the_command_shows_all_verdicts_and_its_exit_code_is_that_of_a_run(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    certs.init(tmp_path / "certs", 2)
    monkeypatch.setattr(doctor, "USES", {"no-such-package": "plots"})
    line = ["doctor", "--uavs", "2", "--out", str(tmp_path), "--tls", str(tmp_path / "certs")]
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(doctor, "_BUS_PORT", server.getsockname()[1])
        assert main(line) == 0
    said = capsys.readouterr().out
    for warning in ("Address already in use", "only needed for plots: pip install 'meanflock[ground]'"):
        assert warning in " ".join(said.split())
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


V1 = ("sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
V2 = ("sys/fs/cgroup", "memory.max", "memory.current", "inactive_file")
OF_HOST = "3:memory:/docker/0123456789ab\n0::/docker/0123456789ab"  # in a container that does not see its group
WIDE, TIGHT = str(2**42), str(64 * MEGABYTE)


@pytest.mark.parametrize(
    ("member", "version", "limits", "used_mb", "left_mb"),
    [
        ("", V2, {}, 0, None),
        ("0::/run", V2, {"run": "max"}, 7, None),
        ("0::/run", V2, {"run": "soon"}, 7, None),
        ("3:memory:/run", V1, {"run": str(2**63 - 4096)}, 7, None),
        *(("0::/pod/run", V2, {"pod/run": WIDE, limited: TIGHT}, 50, 34) for limited in ("pod/run", "pod", "")),
        *(("5:cpu,memory:/pod/run", V1, {"pod/run": WIDE, at: TIGHT}, 50, 34) for at in ("pod/run", "pod", "")),
        (OF_HOST, V1, {"": TIGHT}, 50, 34),
        (OF_HOST, V1, {"": TIGHT}, 90, 0),
    ],
)
def test_the_tightest_limit_of_all_groups_counts_without_reclaimable_cache_else_that_of_the_machine(
    tmp_path, member, version, limits, used_mb, left_mb
) -> None:
    if member:
        (tmp_path / "proc/self").mkdir(parents=True)
        (tmp_path / "proc/self/cgroup").write_text(f"{member}\n")
    mount, most, used, reclaimable = version
    for path, limit in limits.items():
        (folder := tmp_path / mount / path).mkdir(parents=True, exist_ok=True)
        (folder / most).write_text(f"{limit}\n")
        (folder / used).write_text(f"{used_mb * MEGABYTE}\n")
        (folder / "memory.stat").write_text(f"anon 17\n{reclaimable} {20 * MEGABYTE}\nactive_file 5\n")
    available, limit_name = available_mb(tmp_path)
    if left_mb is None:
        assert (0 < available <= psutil.virtual_memory().total // MEGABYTE, limit_name) == (True, "available")
    else:
        assert (available, limit_name) == (left_mb, "left of this container's limit")


@pytest.mark.parametrize(
    ("left_mb", "processes", "verdict", "remedy"),
    [(10**6, 200, "ok", ""), (1000, 200, "fails", "--uavs-per-process 25"), (100, 0, "fails", "--uavs N")],
)
def test_the_doctor_compares_the_need_and_names_a_remedy(monkeypatch, left_mb, processes, verdict, remedy) -> None:
    monkeypatch.setattr(memory, "available_mb", lambda: (left_mb, "left of this container's limit"))
    found = doctor.memory(200, processes)
    assert found.verdict == verdict
    assert f"{needed_mb(200, processes)} MB for 200 UAVs" in found.found
    assert f"{left_mb} MB left of this container's limit" in found.found
    assert remedy in found.remedy


@pytest.mark.parametrize("processes", [0, 4])
def test_memory_that_grows_with_pairs_is_refused_with_the_largest_swarm_that_fits(monkeypatch, processes) -> None:
    monkeypatch.setattr(memory, "available_mb", lambda: (8000, "available"))
    found = doctor.memory(10_000, processes, PAIR_BYTES)
    assert (found.verdict, "grows with N²" in found.remedy) == ("fails", True)
    most = int(found.remedy.split("--uavs ")[1].split(",")[0])
    assert 1000 < most < 10_000
    fits = [doctor.memory(uavs, processes and -(-uavs // 2500), PAIR_BYTES) for uavs in (most, most + 10)]
    assert [one.verdict for one in fits] == ["ok", "fails"]


def test_a_flight_that_ends_before_its_first_round_needs_less_memory() -> None:
    short, long, alone = (
        memory.learner_memory(load(None, [f"duration={seconds}"], method=method)).uav_bytes
        for method, seconds in (("mfgfl-hf", 2.0), ("mfgfl-hf", 60.0), ("mfg", 60.0))
    )
    assert 0 < short == alone < long


@pytest.mark.parametrize(("uavs", "axes"), [(25, 2), (25, 3), (LARGE_SWARM + 1, 2)])
def test_a_run_folder_takes_no_more_than_estimated_and_a_large_recording_is_announced(
    tmp_path, capsys, uavs, axes
) -> None:
    settings = [f"uavs={uavs}", f"space.dimensions={axes}", "stop=duration", "duration=40", "federation.period=50"]
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
def test_a_run_that_does_not_fit_on_the_disk_is_refused(tmp_path, capsys, monkeypatch, free_mb, flags, remedy) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free_mb * 10**6))
    folder = tmp_path / "new" / "runs"
    assert main(["run", "--in-process", "--uavs", "200", "--out", str(folder), *flags]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    most = disk.needed_mb(load(None, ["uavs=200"]), record=not flags)
    assert line.startswith(f"error: disk: up to {most:,} MB for 200 UAVs over ")
    assert f"{free_mb:,} MB free" in line
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
    assert f"{most - 1:,} MB free; make room on its disk" in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before
