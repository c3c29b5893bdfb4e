"""Completion in a shell, by Click's own mechanism: controllers, scenarios, keys and runs.

Nothing here imports NumPy or the classes of plug-ins: a completion takes a tenth of a second, not half of one.
"""

import os
from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import BashComplete, CompletionItem, ZshComplete, add_completion_class

from meanflock import swarm

VARIABLE = "_MEANFLOCK_COMPLETE"  # set by the shell's function while it asks
KEYS = Path(__file__).with_name("keys.csv")  # of a scenario, with what they mean; written by docs/keys.py
_GROUP = "meanflock.controllers"
_RUNS = Path("runs")  # the default folder of runs
_OF_A_RUN = ("scenario.toml", "summary.json")
Items = list[CompletionItem]


def controllers(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Names of the installed controllers."""
    from importlib.metadata import entry_points

    return _beginning(incomplete, sorted({point.name for point in entry_points(group=_GROUP)}))


def scenarios(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Names of the shipped scenarios, else files."""
    return _or_files(incomplete, _shipped())


def missions(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Names of missions, else files."""
    return _or_files(incomplete, (*_shipped(), "all"))


def keys(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Keys of a scenario, each with `=`."""
    import csv

    with KEYS.open(encoding="utf-8", newline="") as file:
        rows = [(key, about) for key, about in csv.reader(file) if f"{key}=".startswith(incomplete)]
    return [CompletionItem(f"{key}=", help=about) for key, about in rows]


def runs(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Folders of runs below `runs`, or below the folder that was typed, the latest first; else files."""
    parent = Path(incomplete if incomplete.endswith("/") else os.path.dirname(incomplete))
    if not incomplete or str(_RUNS).startswith(incomplete):
        parent = _RUNS
    try:
        found = [path for path in parent.iterdir() if any((path / name).is_file() for name in _OF_A_RUN)]
    except OSError:
        found = []
    return _or_files(incomplete, sorted(map(str, found), reverse=True))


def asked() -> bool:
    """Returns whether a shell asks for a completion."""
    return VARIABLE in os.environ


def install() -> None:
    """Let the scripts of Bash and Zsh add no space after `KEY=`. Fish adds none by itself."""
    add_completion_class(_Bash)
    add_completion_class(_Zsh)


class _Bash(BashComplete):
    source_template = BashComplete.source_template.replace(
        "COMPREPLY+=($value)", "COMPREPLY+=($value)\n            [[ $value == *= ]] && compopt -o nospace"
    )


class _Zsh(ZshComplete):
    source_template = ZshComplete.source_template.replace(
        "_describe -V unsorted completions_with_descriptions -U",
        'local -a unspaced; [[ "$completions_with_descriptions[1]" == *=:* ]] && unspaced=(-S "")\n'
        '        _describe -V unsorted completions_with_descriptions -U "${unspaced[@]}"',
    )


def _shipped() -> list[str]:
    """Names of the shipped scenarios; `swarm.toml` has them too, and imports NumPy."""
    return sorted(path.stem for path in Path(swarm.__file__).with_name("scenarios").glob("*.toml"))


def _beginning(incomplete: str, names: Iterable[str]) -> Items:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _or_files(incomplete: str, names: Iterable[str]) -> Items:
    """The names that begin so; if there is none, the shell completes files."""
    return _beginning(incomplete, names) or [CompletionItem(incomplete, type="file")]
