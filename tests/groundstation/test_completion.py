"""Completion in a shell: what is offered for each kind of word, and that nothing that flies is imported for it."""

import os

import pytest
from click.shell_completion import BashComplete

from meanflock.groundstation.cli.command import cli
from meanflock.groundstation.cli.completion import VARIABLE
from tests.commands import loaded

HEAVY = {"numpy", "msgspec", "rich", "pyarrow", "psutil", "matplotlib", "zenoh", "meanflock.agent.controllers"}


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("di", {"diff"}),
        ("run --method mfgfl-h", {"mfgfl-h", "mfgfl-hf"}),
        ("run --plugin absent.py --method pla", {"plan"}),
        ("compare hjb orc", {"orca"}),
        ("sweep wind.sigma=1 --methods hjb orc", {"orca"}),
        ("leaderboard --missions paper al", {"all"}),
        ("leaderboard --controllers lq", {"lqr"}),
        ("run --set wind.si", {"wind.sigma="}),
        ("sweep uav", {"uavs="}),
        ("run wind", {"windy", "windmap"}),
        ("compare hjb --scenario cro", {"crowd"}),
        ("run mine/", {"mine/"}),  # by the shell: a file
        ("show r", {"runs/b", "runs/a"}),
        ("diff runs/a runs/b", {"runs/b"}),
        ("plot other/", {"other/c"}),
        ("resume els", {"els"}),
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


@pytest.mark.parametrize("line", ["meanflock run --method plan", "meanflock sweep uavs", "meanflock show r"])
def test_a_completion_imports_nothing_that_flies(line: str, tmp_path) -> None:
    env = os.environ | {VARIABLE: "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    code = "from meanflock.groundstation.cli.command import main\nassert main() == 0"
    assert loaded(code, cwd=tmp_path, env=env) & HEAVY == set()
