"""The help of every command: an example, each option described, nothing wider than a terminal of 80 columns."""

import re
from collections.abc import Iterator

import click
import pytest

from meanflock.groundstation.cli.command import cli

_COLUMNS = 80


def _commands(command: click.Command, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    yield path, command
    if isinstance(command, click.Group):
        for name, below in command.commands.items():
            yield from _commands(below, (*path, name))


COMMANDS = dict(_commands(cli))
_every = pytest.mark.parametrize("path", COMMANDS, ids=lambda path: " ".join(path) or "meanflock")


@pytest.fixture
def told(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(_COLUMNS))

    def ask(path: tuple[str, ...]) -> str:
        code, out, _ = run(*path, "--help")
        assert code == 0
        return out

    return ask


@_every
def test_no_line_is_wider_than_the_terminal_or_cut_off(told, path) -> None:
    shown = told(path)
    assert [line for line in shown.splitlines() if len(line) > _COLUMNS] == []
    assert [line for line in shown.partition("Commands:\n")[2].splitlines() if line.endswith("...")] == []


@_every
def test_the_example_is_of_this_command(told, path) -> None:
    example = re.search(r"^  Example:\s+(meanflock .+)$", told(path), re.MULTILINE)
    assert example is not None
    assert example[1].split()[1 : len(path) + 1] == list(path)


@_every
def test_every_option_is_described(path) -> None:
    options = [option for option in COMMANDS[path].params if isinstance(option, click.Option)]
    assert [option.opts[-1] for option in options if not option.help] == []


def test_commands_are_listed_in_the_order_of_their_use(told) -> None:
    listed = re.findall(r"^  ([a-z]+)  ", told(()).partition("Commands:\n")[2], re.MULTILINE)
    assert listed[:3] == ["run", "resume", "view"]
    assert sorted(listed) == sorted(cli.commands)
