"""Files of the project that are no modules: programs that write pages, and examples; commands and code of pages."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import click
from meanflock.cli.command import cli

ROOT = Path(__file__).parents[1]


def script_of(name: str, folder: str = "docs") -> ModuleType:
    """The file of that name, imported."""
    spec = importlib.util.spec_from_file_location(name, ROOT / folder / f"{name}.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def commands(command: click.Command = cli, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], click.Command]:
    """All commands and groups of commands, by the words that call them."""
    found = {path: command}
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            found |= commands(below, (*path, name))
    return found


def modules_of(page: Path) -> dict[str, str]:
    """Python of a page by file name: blocks that begin with a comment `# NAME.py`, and all others as one script."""
    modules = {page.name.replace(".", "_") + ".py": ""}
    (script,) = modules
    for code in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.M | re.S):
        if name := re.match(r"# (\w+\.py)\n", code):
            modules[name[1]] = code[name.end() :].lstrip("\n")
        else:
            modules[script] += code
    return modules
