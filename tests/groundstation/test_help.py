"""The help of every command: an example, each option described, nothing wider than a terminal of 80 columns."""

import re

import click
import pytest

from meanflock.swarm.errors import EXIT_DONE, MeanflockError
from meanflock.swarm.toml import shipped
from tests.commands import loaded
from tests.groundstation.conftest import QUICK
from tests.pages import commands

_COLUMNS = 80


COMMANDS = commands()


@pytest.fixture
def told(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(_COLUMNS))

    def ask(path: tuple[str, ...]) -> str:
        code, out, _ = run(*path, "--help")
        assert code == 0
        return out

    return ask


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: " ".join(path) or "meanflock")
def test_help_has_an_example_describes_every_option_and_fits_the_terminal(told, path) -> None:
    shown = told(path)
    assert [line for line in shown.splitlines() if len(line) > _COLUMNS] == []
    assert [line for line in shown.partition("Commands:\n")[2].splitlines() if line.endswith("...")] == []
    example = re.search(r"^  Example:\s+(meanflock .+)$", shown, re.MULTILINE)
    assert example is not None
    assert example[1].split()[1 : len(path) + 1] == list(path)
    options = [option for option in COMMANDS[path].params if isinstance(option, click.Option)]
    assert [option.opts[-1] for option in options if not option.help] == []


def test_help_names_every_scenario_and_every_exit_code(told) -> None:
    def codes(kind: type[MeanflockError]) -> set[int]:
        return {kind.exit_code}.union(*map(codes, kind.__subclasses__()))

    said = told(("run",))
    assert [path.stem for path in shipped() if f"{path.stem}," not in said and f"{path.stem}." not in said] == []
    listed = told(()).partition("Exit codes:\n")[2].partition("\n\n")[0]
    named = set(map(int, re.findall(r"^ +(\d)  \w", listed, re.MULTILINE)))
    assert named == codes(MeanflockError) | {EXIT_DONE}


def test_commands_are_listed_in_the_order_of_their_use_with_the_first_line_of_their_help(told) -> None:
    lines = re.findall(r"^  ([a-z]+)  +(.+)$", told(()).partition("Commands:\n")[2], re.MULTILINE)
    assert [name for name, _ in lines][:3] == ["run", "resume", "view"]
    first = [(path[0], command) for path, command in COMMANDS.items() if len(path) == 1]
    assert lines == [(name, command.get_short_help_str(_COLUMNS)) for name, command in first]


DRAWING = ["rerun", "rerun_bindings", "matplotlib"]


@pytest.mark.parametrize(
    ("arguments", "forbidden"),
    [
        (["--help"], [*DRAWING, "numpy", "pyarrow", "rich", "psutil", "zenoh", "meanflock.groundstation.cli.fly"]),
        (["run", "--help"], [*DRAWING, "numpy", "pyarrow", "rich", "psutil", "zenoh"]),
        ([*QUICK, "--json"], [*DRAWING, "zenoh", "pyarrow.compute", "cryptography", "prometheus_client", "scipy"]),
    ],
    ids=["help", "help of run", "run"],
)
def test_a_command_loads_only_what_it_needs(tmp_path, arguments, forbidden) -> None:
    code = f"from meanflock.groundstation.cli.command import main\nassert main({list(arguments)}) == 0"
    assert loaded(code, cwd=tmp_path) & set(forbidden) == set()
