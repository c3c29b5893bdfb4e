"""The documentation is executed: what it says to type works, and what can be typed is in it."""

import importlib.util
import re
import shlex
from pathlib import Path

import click
import pytest

from meanflock.groundstation.cli import cli, main

ROOT = Path(__file__).parents[1]
CLI = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands(text: str) -> list[str]:
    """Lines that call meanflock, in boxes marked sh."""
    boxes = re.findall(r"^```sh\n(.*?)^```", text, flags=re.M | re.S)
    lines = [line.split("#")[0].strip() for box in boxes for line in box.splitlines()]
    return [line.removeprefix(".venv/bin/") for line in lines if re.match(r"(\.venv/bin/)?meanflock ", line)]


def verbs(group: click.Group, prefix: str = "") -> dict[str, click.Command]:
    found: dict[str, click.Command] = {}
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            found |= verbs(command, f"{prefix}{name} ")
        else:
            found[prefix + name] = command
    return found


@pytest.mark.processes
@pytest.mark.parametrize("line", commands(CLI))
def test_every_command_of_the_reference_works(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(line)[1:]) == 0


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_of_every_page_is_one_that_exists(page: Path) -> None:
    for line in commands(page.read_text(encoding="utf-8")):
        words = shlex.split(line.replace("<id>", "id").split(">")[0].split("|")[0])[1:]
        verb = next(v for v in sorted(verbs(cli), key=len, reverse=True) if words[: len(v.split())] == v.split())
        arguments = words[len(verb.split()) :]
        verbs(cli)[verb].make_context(verb, arguments, resilient_parsing=False)


def test_every_verb_and_every_option_of_a_flight_is_in_the_reference() -> None:
    for verb, command in verbs(cli).items():
        assert f"meanflock {verb}" in CLI or f"`{verb}`" in CLI, verb
        if verb in ("run", "resume"):
            for option in command.params:
                if isinstance(option, click.Option):
                    assert option.opts[0] in CLI, option.opts[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_between_pages_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_sizes_of_payloads_on_the_page_are_those_of_today() -> None:
    spec = importlib.util.spec_from_file_location("communication", ROOT / "docs" / "communication.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert "\n".join(script.transmissions()) in script.PAGE.read_text(encoding="utf-8")
