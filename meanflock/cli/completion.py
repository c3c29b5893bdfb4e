"""Completion in a shell, by Click's own mechanism: controllers, scenarios, keys, their values, and runs.

Nothing here imports NumPy or the classes of plug-ins: a completion takes a tenth of a second, not half of one.
"""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import click
from click.shell_completion import BashComplete, CompletionItem, ZshComplete, add_completion_class, split_arg_string

from meanflock import swarm

VARIABLE = "_MEANFLOCK_COMPLETE"  # set by the shell's function while it asks
KEYS = Path(__file__).with_name("keys.csv")  # rows as `_CompletedKey`; written by docs/keys.py
_GROUP = "meanflock."  # begins the name of each group of entry points
RUNS = Path("runs")  # the default folder of runs
LATEST = "latest"  # in place of a run: the one in that folder that began last
_OF_A_RUN = ("scenario.toml", "summary.json")
Items = list[CompletionItem]


class _CompletedKey(NamedTuple):
    """A key of a scenario.

    needs: `KEY=NAME…`, the plug-ins of which it is an option; else empty. values: those that it can have, and groups of
    plug-ins whose names it can have, separated by spaces; else empty. about: what it means.
    """

    key: str
    needs: str
    values: str
    about: str


def controllers(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Names of the installed controllers."""
    return _beginning(incomplete, _plugins("meanflock.controllers"))


def learners(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Names of the installed learners, else files."""
    return _or_files(incomplete, _plugins("meanflock.learners"))


def scenarios(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Names of the shipped scenarios, else files."""
    return _or_files(incomplete, _shipped())


def missions(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Names of missions, else files."""
    return _or_files(incomplete, (*_shipped(), "all"))


def keys(context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Keys of a scenario, each with `=`; behind it, the values of a key that names a plug-in or has a few.

    Options of plug-ins are those of the chosen ones, and of all where none is chosen.
    """
    chosen = dict(setting.partition("=")[::2] for setting in context.params.get("settings") or ())
    if isinstance(method := context.params.get("method"), str):
        chosen["method"] = method
    rows = [row for row in _keys() if _applies(row, chosen)]
    key, equals, values = incomplete.partition("=")
    if not equals:
        matching = {row.key: row.about for row in reversed(rows) if row.key.startswith(incomplete)}
        return [CompletionItem(f"{name}=", help=matching[name]) for name in reversed(matching)]
    typed = incomplete[: len(incomplete) - len(values.rpartition(",")[2])]  # a sweep has several values
    offered = dict.fromkeys(value for row in rows if row.key == key for value in _values(row))
    return _beginning(incomplete, [typed + value for value in offered])


def runs(_context: click.Context, _parameter: click.Parameter, incomplete: str) -> Items:
    """Folders of runs below `runs`, or below the folder that was typed, the latest first; `latest`; else files."""
    parent = Path(incomplete if incomplete.endswith("/") else os.path.dirname(incomplete))
    if not incomplete or str(RUNS).startswith(incomplete):
        parent = RUNS
    try:
        found = [path for path in parent.iterdir() if any((path / name).is_file() for name in _OF_A_RUN)]
    except OSError:
        found = []
    return _or_files(incomplete, [*sorted(map(str, found), reverse=True), *([LATEST] if incomplete else [])])


def asked() -> bool:
    """Returns whether a shell asks for a completion."""
    return VARIABLE in os.environ


def install() -> None:
    """Let the scripts of Bash and Zsh add no space after `KEY=`. Fish adds none by itself."""
    add_completion_class(_Bash)
    add_completion_class(_Zsh)


class _Bash(BashComplete):
    """Bash hands over `KEY=VALUE` as three words, and replaces the last of them only."""

    _before = ""  # the part of the incomplete word that stays

    def get_completion_args(self) -> tuple[list[str], str]:
        last = int(os.environ["COMP_CWORD"])
        parts = [*split_arg_string(os.environ["COMP_WORDS"]), ""][1 : last + 1]
        words: list[str] = []
        for before, part in zip(["", *parts], parts, strict=False):
            if words and (part == "=" or before == "="):
                self._before = words[-1] + "=" * (part == "=")
                words[-1] += part
            else:
                self._before = ""
                words.append(part)
        return words[:-1], words[-1]

    def format_completion(self, item: CompletionItem) -> str:
        return f"{item.type},{item.value.removeprefix(self._before)}"

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


def _keys() -> Iterable[_CompletedKey]:
    import csv

    with KEYS.open(encoding="utf-8", newline="") as file:
        yield from map(_CompletedKey._make, csv.reader(file))


def _applies(row: _CompletedKey, chosen: dict[str, str]) -> bool:
    """Returns whether a key is an option of no plug-in, or of a chosen one, or none of its kind is chosen."""
    key, _, names = row.needs.partition("=")
    return key not in chosen or chosen[key] in names.split()


def _values(row: _CompletedKey) -> list[str]:
    words = row.values.split()
    return [name for word in words for name in (_plugins(word) if word.startswith(_GROUP) else [word])]


def _plugins(group: str) -> list[str]:
    """Names of the installed plug-ins of a group of entry points."""
    from importlib.metadata import entry_points

    return sorted({point.name for point in entry_points(group=group)})


def _beginning(incomplete: str, names: Iterable[str]) -> Items:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _or_files(incomplete: str, names: Iterable[str]) -> Items:
    """The names that begin so; if there is none, the shell completes files."""
    return _beginning(incomplete, names) or [CompletionItem(incomplete, type="file")]
