"""The rule for paths of users, and reading of files that others wrote: regular files of a bounded size only."""

import os
from pathlib import Path

import pytest

from meanflock.swarm import paths, toml
from meanflock.swarm.errors import BadInput

NOT_UTF_8 = os.fsdecode(b"caf\xe9")


def test_a_tilde_is_the_home_folder_and_everything_else_stays_as_it_is(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert paths.given("~/runs") == tmp_path / "runs"
    assert paths.given(Path("~")) == tmp_path
    assert paths.given(paths.given("./~/runs")) == Path.cwd() / "~/runs"
    for text in ("runs", "a~b", "sigma:0.3", "-x", "/é", str(tmp_path)):
        assert str(paths.given(text)) == str(Path(text))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("~nobody-has-this-name/runs", "no such home folder; write the whole path, or ./~nobody"),
        (NOT_UTF_8, r"caf\\udce9: the path is not UTF-8"),
        ("a\0b", r"a\\x00b: no path contains NUL"),
    ],
)
def test_a_path_that_some_library_cannot_use_is_refused(text: str, says: str) -> None:
    with pytest.raises(BadInput, match=says):
        paths.given(text)


def test_a_name_in_a_working_folder_that_is_not_utf_8_or_gone_is_refused(tmp_path: Path, monkeypatch) -> None:
    folder = tmp_path / NOT_UTF_8
    folder.mkdir()
    monkeypatch.chdir(folder)
    with pytest.raises(BadInput, match="not UTF-8"):
        paths.given("runs")
    folder.rmdir()
    with pytest.raises(BadInput, match="working folder is gone"):
        paths.given("runs")


def test_only_regular_files_are_read_and_none_that_is_too_large(tmp_path: Path) -> None:
    (plain := tmp_path / "plain").write_bytes(b"12345678")
    (pipe := tmp_path / "pipe", os.mkfifo(tmp_path / "pipe"))
    (zero := tmp_path / "zero").symlink_to("/dev/zero")
    with (sparse := tmp_path / "sparse").open("wb") as file:
        file.truncate(2**40)
    assert (paths.read(plain), paths.read(plain, 8)) == (b"12345678", b"12345678")
    for path, says in ((pipe, "not a regular"), (zero, "not a regular"), (tmp_path, "not a regular"), (sparse, "larg")):
        with pytest.raises(OSError, match=says):
            paths.read(path)
    with pytest.raises(OSError, match="larger than 7 bytes"):
        paths.read(plain, 7)


def test_a_scenario_may_come_through_a_pipe_but_not_without_end(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    os.write(writing, b"\xef\xbb\xbfuavs = 3\r\n")
    os.close(writing)
    try:
        assert toml.read(Path(f"/dev/fd/{reading}"), "scenario file") == {"uavs": 3}
    finally:
        os.close(reading)
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    with pytest.raises(BadInput, match=r"zero\.toml: larger than 67108864 bytes; give a readable scenario file"):
        toml.read(tmp_path / "zero.toml", "scenario file")
