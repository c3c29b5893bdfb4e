"""Help and completion of every command: described, within 80 columns, and nothing loaded that is not needed."""

import os
import re
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import BashComplete

from meanflock.cli.command import cli
from meanflock.cli.completion import VARIABLE
from meanflock.swarm import plugins
from meanflock.swarm.errors import EXIT_DONE, MeanflockError
from meanflock.swarm.toml import shipped
from tests.commands import printed
from tests.pages import commands

COLUMNS = 80
COMMANDS = commands()


@pytest.fixture
def told(run, monkeypatch):
    """Asks for the help of a command on a narrow terminal."""
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    return lambda path: run(*path, "--help")[1]


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: " ".join(path) or "meanflock")
def test_help_has_an_example_describes_every_option_and_fits_the_terminal(told, path) -> None:
    shown = told(path)
    assert [line for line in shown.splitlines() if len(line) > COLUMNS] == []
    assert [line for line in shown.partition("Commands:\n")[2].splitlines() if line.endswith("...")] == []
    example = re.search(r"^  Example:\s+(meanflock .+)$", shown, re.MULTILINE)
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


@pytest.mark.parametrize("path", [("run",), ("doctor",)], ids=" ".join)
def test_a_command_that_flies_or_checks_a_scenario_takes_all_of_its_options(path) -> None:
    names = {option.name for option in COMMANDS["scenario", "show"].params}
    assert names - {option.name for option in COMMANDS[path].params} == set()


def test_commands_are_listed_in_the_order_of_their_use_with_the_first_line_of_their_help(told) -> None:
    lines = re.findall(r"^  ([a-z]+)  +(.+)$", told(()).partition("Commands:\n")[2], re.MULTILINE)
    assert [name for name, _ in lines][:3] == ["run", "resume", "view"]
    first = [(path[0], command) for path, command in COMMANDS.items() if len(path) == 1]
    assert lines == [(name, command.get_short_help_str(COLUMNS)) for name, command in first]


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("di", {"diff"}),
        ("run --method mfgfl-h", {"mfgfl-h", "mfgfl-hf"}),
        ("compare hjb orc", {"orca"}),
        ("sweep wind.sigma=1 --methods hjb orc", {"orca"}),
        ("leaderboard --missions paper al", {"all"}),
        ("frontier --missions stre", {"streams"}),
        ("run --set wind.si", {"wind.sigma="}),
        ("sweep uav", {"uavs="}),
        ("run --set federation.topology=", {f"federation.topology={name}" for name in plugins.names("topology")}),
        ("run --set filter.kind=", {f"filter.kind={name}" for name in ("none", "braking", "ecbf")}),
        ("run --set method=mfgfl-h", {"method=mfgfl-h", "method=mfgfl-hf"}),
        ("run --set federation.error_feedback=t", {"federation.error_feedback=true"}),
        ("sweep controller.share=true,f", {"controller.share=true,false"}),
        ("run --set wind.sigma=", set()),
        ("run --set controller.fi", {"controller.file="}),
        ("run --method orca --set controller.fi", set()),
        ("run --method rls --set controller.s", {"controller.share=", "controller.speed_m_s="}),
        ("run --set method=rls --set controller.share=", {"controller.share=true", "controller.share=false"}),
        ("run --set filter.kind=ecbf --set filter.options.n", {"filter.options.neighbours="}),
        ("run wind", {"windy", "windmap"}),
        ("compare hjb --scenario cro", {"crowd"}),
        ("run mine/", {"mine/"}),  # by the shell: a file
        ("show r", {"runs/b", "runs/a"}),
        ("diff runs/a runs/b", {"runs/b"}),
        ("bridge mavlink runs", {"runs/b", "runs/a"}),
        ("new veh", {"vehicle"}),
        ("run --realtime -1 --tl", {"--tls"}),
    ],
)
def test_words_are_completed(line: str, offered: set[str], tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("runs/a", "runs/b", "other/c"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "scenario.toml").touch()
    (tmp_path / "runs" / "empty").mkdir()
    *words, incomplete = line.split()
    items = BashComplete(cli, {}, "meanflock", VARIABLE).get_completions(words, incomplete)
    assert {item.value for item in items} == offered


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("run --set filter.kind = e", "ecbf"),  # the three words that Bash makes of one
        ("run --set federation.topology =", "clusters leader neighbours stations"),
        ("run --set method = rls --set controller.share = t", "true"),
        ("sweep method = plan,orc", "plan,orca"),
        ("run --method = windm", "windmap"),
    ],
)
def test_bash_completes_values(words: str, offered: str, tmp_path) -> None:
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    code = (
        f'eval "$({VARIABLE}=bash_source meanflock)"; COMP_WORDS=(meanflock {words}); COMP_CWORD={len(words.split())}; '
    )
    code += "_meanflock_completion meanflock; echo ${COMPREPLY[@]}"
    assert printed("bash", "-c", code, cwd=tmp_path, env=environment) == f"{offered}\n"
