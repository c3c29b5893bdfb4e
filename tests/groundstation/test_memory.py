"""What a swarm needs of memory, and what there is where a container is allowed less than the machine has."""

from pathlib import Path

import psutil
import pytest

from meanflock.groundstation import doctor, memory
from meanflock.groundstation.memory import MEGABYTE, available_mb, needed_mb

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


def test_without_limits_it_is_what_the_machine_has(tmp_path: Path) -> None:
    for root in (tmp_path / "nothing", tmp_path / "max", tmp_path / "v1"):
        if root.name == "max":
            member_of(root, "0::/user/run")
            group(root, "user", version=2, limit="max", used_mb=7)
        if root.name == "v1":
            member_of(root, "4:cpu:/", "3:memory:/run", "0::/")
            group(root, "run", version=1, limit=str(2**63 - 4096), used_mb=7)
        available, what = available_mb(root)
        assert 0 < available <= MACHINE
        assert what == "available"


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("limited", ["pod/run", "pod", ""])
def test_the_tightest_limit_on_the_way_up_counts_and_cache_that_can_go_does_not(
    tmp_path: Path, version: int, limited: str
) -> None:
    member_of(tmp_path, "5:cpu,memory:/pod/run" if version == 1 else "0::/pod/run")
    group(tmp_path, "pod/run", version=version, limit=str(2**42), used_mb=10)
    group(tmp_path, limited, version=version, limit=str(64 * MEGABYTE), used_mb=50, cache_mb=20)
    assert available_mb(tmp_path) == (34, "left of this container's limit")


def test_inside_a_container_the_mount_is_the_container_s_own_group(tmp_path: Path) -> None:
    member_of(
        tmp_path, "3:memory:/docker/0123456789ab", "0::/docker/0123456789ab"
    )  # the host's path: not to be seen here
    group(tmp_path, "", version=1, limit=str(48 * MEGABYTE), used_mb=16)
    assert available_mb(tmp_path)[0] == 32


def test_a_group_that_uses_more_than_its_limit_has_nothing_left(tmp_path: Path) -> None:
    member_of(tmp_path, "0::/")
    group(tmp_path, "", version=2, limit=str(8 * MEGABYTE), used_mb=9)
    assert available_mb(tmp_path)[0] == 0


def test_a_file_nobody_can_read_as_a_limit_is_none(tmp_path: Path) -> None:
    member_of(tmp_path, "0::/run")
    group(tmp_path, "run", version=2, limit="soon", used_mb=9)
    assert available_mb(tmp_path)[1] == "available"


def test_the_need_grows_with_processes_uavs_and_where_states_are_kept_with_pairs() -> None:
    assert needed_mb(25, 25) - needed_mb(25, 1) == 24 * memory.AGENT_MB
    assert needed_mb(1000, 0) < needed_mb(1000, 4) < needed_mb(1000, 1000)
    assert needed_mb(10_000, 0) < 1000 < needed_mb(10_000, 0, keeps_states=True)


@pytest.mark.parametrize(
    ("left_mb", "processes", "verdict", "mend"),
    [
        (10**6, 200, "ok", ""),
        (1000, 200, "fails", "--uavs-per-process 25"),
        (100, 200, "fails", "--uavs N"),
        (100, 0, "fails", "--uavs N"),
    ],
)
def test_the_finding_says_what_is_needed_what_is_there_and_what_would_help(
    monkeypatch: pytest.MonkeyPatch, left_mb: int, processes: int, verdict: str, mend: str
) -> None:
    monkeypatch.setattr(doctor, "available_mb", lambda: (left_mb, "left of this container's limit"))
    found = doctor.memory(200, processes)
    assert found.verdict == verdict
    assert f"{needed_mb(200, processes)} MB for 200 UAVs" in found.found
    assert f"{left_mb} MB left of this container's limit" in found.found
    assert mend in found.mend
