"""Memory and disk space: the need of a swarm, what a machine or a container grants, and what is refused."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

import meanflock as mf
from meanflock.groundstation import disk, doctor
from meanflock.groundstation.cli.command import main
from meanflock.groundstation.disk import LARGE_SWARM
from meanflock.groundstation.memory import MEGABYTE, available_mb, needed_mb
from meanflock.swarm.scenario import load
from tests.faults.conftest import scenario
from tests.faults.dying import dead

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


def test_a_flight_in_python_that_would_not_fit_is_refused_in_its_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=80 * 10**6))
    with pytest.raises(mf.BadInput, match="80 MB free; fly without the recording: record=False"):
        mf.fly(uavs=200, out=tmp_path / "new", record=True)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    with pytest.raises(mf.BadInput, match=r"0 MB free; a shorter flight: duration=S; or .*: out=DIR"):
        mf.fly(uavs=2, duration=1, out=tmp_path / "new")
    assert not (tmp_path / "new").exists()
    assert mf.fly(uavs=2, duration=1).summary["uavs"] == 2  # writes nothing


def test_a_run_is_resumed_only_if_the_rest_of_it_fits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = scenario("duration=1000", "stop=duration", "uavs=50")
    folder, whole = dead(tmp_path, flown, 1500), disk.needed_mb(flown, record=False)
    most = disk.needed_mb(flown, record=False, flown=1500)
    assert most < whole
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=(most - 1) * 10**6))
    before = sorted(folder.iterdir())
    assert main(["resume", str(folder), "--in-process", "--no-record"]) == 2
    assert f"{most - 1} MB free; make room on its disk" in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before
