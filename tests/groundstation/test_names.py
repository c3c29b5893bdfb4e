"""Names that several processes choose at the same time: everyone gets a folder, and every file is whole."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import TypeVar

import pytest
from meanflock.results.run_folder import RunFolder

import meanflock as mf
from meanflock.cli import scaffold
from meanflock.studies.store import Store
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput

AT_ONCE = 8
T = TypeVar("T")


def at_once(call: Callable[[int], T]) -> list[T]:
    """The results of eight calls that begin together."""
    begin = Barrier(AT_ONCE)

    def called(number: int) -> T:
        begin.wait()
        return call(number)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(called, range(AT_ONCE)))


def test_everyone_who_asks_for_the_same_name_gets_a_new_folder(tmp_path: Path) -> None:
    def own(number: int) -> str:
        with durable.new_folder(tmp_path / "grid", "run") as folder:
            (folder / "file").write_text(str(number))
        return folder.name

    assert sorted(at_once(own)) == ["run", *(f"run-{number}" for number in range(1, AT_ONCE))]
    assert {path.read_text() for path in tmp_path.glob("grid/*/file")} == set(map(str, range(AT_ONCE)))


def test_a_new_folder_that_stays_empty_is_removed_with_its_parent_unless_others_use_it(tmp_path: Path) -> None:
    with durable.new_folder(tmp_path / "grid", "run"):
        pass
    assert list(tmp_path.iterdir()) == []
    with durable.new_folder(tmp_path / "grid", "run"), durable.new_folder(tmp_path / "grid", "run") as other:
        (other / "file").touch()
    assert [path.name for path in tmp_path.rglob("*")] == ["grid", "run-1", "file"]


def test_flights_that_begin_in_the_same_second_have_a_folder_each(tmp_path: Path) -> None:
    def flown(number: int) -> Path | None:
        return mf.fly(
            method="offline", uavs=2, duration=1.0, seed=3, out=tmp_path, **{"wind.sigma": number / 10}
        ).folder

    folders = at_once(flown)
    assert len(set(folders)) == AT_ONCE
    for number, folder in enumerate(folders):
        assert folder is not None
        assert mf.open(folder).scenario.wind.sigma == number / 10


def test_a_folder_with_files_in_it_is_not_taken_for_a_new_run(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "file").touch()
    with pytest.raises(BadInput, match="File exists"):
        RunFolder(tmp_path, "run", mf.Scenario(uavs=2))
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["file"]


def test_a_file_that_many_replace_at_once_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    contents = [bytes([number]) * 100_000 for number in range(AT_ONCE)]

    def write(number: int) -> None:
        for _ in range(5):
            durable.replace(path, contents[number])

    at_once(write)
    assert path.read_bytes() in contents
    assert [each.name for each in tmp_path.iterdir()] == ["table.csv"]


def test_a_study_leaves_the_file_that_another_one_writes(tmp_path: Path) -> None:
    Store(tmp_path)
    written, forgotten = (tmp_path / "data" / "jobs" / f".{name}.job.0a.part" for name in ("new", "old"))
    for path in (written, forgotten):
        path.touch()
    os.utime(forgotten, (0.0, 0.0))
    Store(tmp_path)
    assert (written.exists(), forgotten.exists()) == (True, False)


def test_of_two_new_packages_of_one_name_one_is_refused(tmp_path: Path) -> None:
    def new(_: int) -> str:
        try:
            return str(len(scaffold.create("controller", "swirl_once", tmp_path)))
        except BadInput as error:
            return str(error)

    made, *refused = sorted(at_once(new), key=len)
    assert (made, len(refused)) == ("6", AT_ONCE - 1)
    assert all("swirl_once: exists already" in text for text in refused)
    assert [path.name for path in tmp_path.iterdir()] == ["swirl_once"]
