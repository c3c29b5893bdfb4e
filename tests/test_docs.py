"""The documentation is executed: what it says to type works, and what can be typed is in it."""

import importlib
import inspect
import os
import re
import shlex
import sys
import textwrap
import tomllib
from operator import attrgetter
from pathlib import Path
from typing import Any

import click
import pytest

import meanflock as mf
from meanflock.cli.command import main
from meanflock.studies import runner
from meanflock.swarm import __version__
from meanflock.swarm.scenario import Scenario, keys_of
from meanflock.testing import check_controller
from research import communication
from tests.commands import printed
from tests.pages import commands, modules_of, script_of
from tests.sources import MODULES, PROJECT, ROOT

CLI = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
EXECUTED = [
    "first-flight",
    "your-controller",
    "your-aggregation",
    "your-channel",
    "your-vehicle",
    "your-study",
    "lasting-missions",
    "recorded-movement",
    "groups",
    "train-in-flight",
    "train-a-policy",
    "flower",
    "containers",
]  # whole, each in a folder of its own
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PRIVATE = r"\b(doors?|house|tour|minds?|chorus|reflex(es)?|siblings?|hearsay|spoken|plain ticks?|by their bytes)\b"
VERBS = {" ".join(path): command for path, command in commands().items() if not isinstance(command, click.Group)}


def lines(text: str) -> list[str]:
    """Lines that call meanflock, in boxes marked sh."""
    boxes = re.findall(r"^```sh\n(.*?)^```", text, flags=re.M | re.S)
    found = [line.split("#")[0].strip() for box in boxes for line in box.splitlines()]
    return [line.removeprefix(".venv/bin/") for line in found if re.match(r"(\.venv/bin/)?meanflock ", line)]


def run_of_page(page: Path, folder: Path) -> tuple[str, str]:
    """Writes the files of a page, runs its commands and its script; the output, and the output that the page shows."""
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    for name, code in modules_of(page).items():
        (folder / name).write_text(code, encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    for code in re.findall(r"^```sh\n(.*?)^```", text, flags=re.M | re.S):
        printed("bash", "-ec", code, cwd=folder, env=env)
    shown = re.findall(r"^```text\n(.*?)\n```|^ *print\([^\n]*\)  # ([^\n]*)$", text, flags=re.M | re.S)
    script = page.name.replace(".", "_") + ".py"
    return printed(sys.executable, script, cwd=folder, env=env), "".join(f"{box or line}\n" for box, line in shown)


def test_every_controller_of_ours_is_described() -> None:
    text = (
        (ROOT / "docs" / "controllers.md").read_text(encoding="utf-8").replace("`-f`, `-hf`", "`mfgfl-f`, `mfgfl-hf`")
    )
    assert not [name for name in PROJECT["entry-points"]["meanflock.controllers"] if f"`{name}`" not in text]


@pytest.mark.processes
@pytest.mark.parametrize("line", lines(CLI))
def test_every_command_of_the_reference_works(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies fly in this process; that their flights are the same in a pool: tests/studies/test_runner.py."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runner, "cores", lambda: 1)
    assert main(shlex.split(line)[1:]) == 0


@pytest.mark.processes
@pytest.mark.parametrize("name", EXECUTED)
def test_every_block_of_code_of_a_page_runs_and_prints_what_the_page_says(name: str, tmp_path: Path) -> None:
    printed, expected = run_of_page(ROOT / "docs" / f"{name}.md", tmp_path)
    assert printed == expected
    for file in tmp_path.glob("*.py"):  # what a page grows is what lies among the examples
        if (example := ROOT / "examples" / file.name).exists():
            assert file.read_text(encoding="utf-8") == example.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", [page for page in PAGES if page.stem not in EXECUTED], ids=lambda page: page.name)
def test_every_command_of_every_other_page_is_one_that_exists(page: Path) -> None:
    for line in lines(page.read_text(encoding="utf-8")):
        words = shlex.split(line.replace("<id>", "id").split(">")[0].split("|")[0])[1:]
        verb = next(v for v in sorted(VERBS, key=len, reverse=True) if words[: len(v.split())] == v.split())
        arguments = words[len(verb.split()) :]
        VERBS[verb].make_context(verb, arguments, resilient_parsing=False)


def test_every_verb_and_every_option_is_in_the_reference() -> None:
    for verb, command in VERBS.items():
        assert f"meanflock {verb}" in CLI or f"`{verb}`" in CLI, verb
        for option in command.params:
            if isinstance(option, click.Option):
                assert re.search(rf"{option.opts[-1]}\b", CLI), f"{verb} {option.opts[-1]}"


@pytest.mark.parametrize("room", ["worldsim", "leader", "agent", "groundstation"])
def test_every_flag_of_a_process_is_in_the_reference(room: str) -> None:
    said = printed(sys.executable, "-m", f"meanflock.{room}", "--help", env=os.environ | {"COLUMNS": "80"})
    assert [line for line in said.splitlines() if len(line) > 80] == []
    assert f"example: python -m meanflock.{room} " in said
    section = CLI.partition("## The processes themselves")[2]
    for flag in set(re.findall(r"^  (--[a-z-]+)", said, flags=re.M)):
        assert f"`{flag}`" in section, flag


def test_the_controller_on_the_first_page_conforms() -> None:
    code = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.M | re.S)[0]
    names: dict[str, Any] = {}
    exec(code, names)
    check_controller(names["Spring"])
    assert len(code.splitlines()) <= 20


def test_every_message_that_troubleshooting_quotes_is_one_that_the_code_has() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    quoted = {
        text for cell in re.findall(r"^\| ([^|]*`[^|]*) \|", page, flags=re.M) for text in re.findall("`([^`]+)`", cell)
    }
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "Makefile", *MODULES))
    assert len(quoted) > 25
    assert [text for text in quoted if text not in code] == []


def anchors(page: Path) -> set[str]:
    """What a link may name on a page: its headings in small letters, with hyphens for spaces and without signs."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    headings = [
        re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading) for heading in re.findall(r"^#+ (.*)$", text, flags=re.M)
    ]
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_every_link_and_every_file_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target, place in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", text):
        if "://" in target:
            continue
        file = page.parent / target if target else page
        assert file.exists(), f"{page.name}: {target}"
        if place and file.suffix == ".md":
            assert place in anchors(file), f"{page.name}: {target}#{place}"
    for name in re.findall(r"`(\w[\w.-]*/[\w./-]+\.(?:py|c|h|toml|md|csv))`", text):
        assert page.name == "CHANGELOG.md" or (ROOT / name).exists(), f"{page.name}: {name}"
    if page.name != "performance.md":  # names of parts come from the record of the benchmarks
        assert not re.findall(PRIVATE, text, flags=re.I)


def test_every_page_has_its_place_in_the_navigation_of_the_site() -> None:
    website = script_of("website")
    site = tomllib.loads((ROOT / "docs" / "theme" / "zensical.toml").read_text(encoding="utf-8"))["project"]
    entries = [entry for group in site["nav"] for entry in group.values()]
    placed = [path for entry in entries for path in ([entry] if isinstance(entry, str) else map(dict.popitem, entry))]
    paths = [path if isinstance(path, str) else path[1] for path in placed]
    assert sorted(paths) == sorted(str(page.relative_to(ROOT)) for page in website.pages())


@pytest.mark.parametrize("name", ["api", "data", "keys"])
def test_a_written_page_is_that_of_the_code(name: str) -> None:
    script = script_of(name)
    assert script.PAGE.read_text(encoding="utf-8") == script.page(), f"run `python docs/{name}.py`"


def test_code_that_the_page_on_architecture_quotes_is_that_of_the_source() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    quotes = re.findall(r"<!-- source: (\S+) ([^\n]+) -->\n```python\n(.*?)```", page, re.DOTALL)
    assert len(quotes) == 2
    for module, names, quoted in quotes:
        found = [attrgetter(name)(importlib.import_module(module)) for name in names.split()]
        assert quoted == "\n\n".join(textwrap.dedent(inspect.getsource(one)) for one in found)


def test_pages_have_the_numbers_and_names_of_the_code() -> None:
    keys, api = script_of("keys"), script_of("api")
    assert set(keys.keys()) <= set(keys_of(Scenario))  # each is described
    assert keys.COMPLETED.read_text(encoding="utf-8") == keys.completed(), "run `python docs/keys.py`"
    assert {name for _, names in api.SECTIONS.values() for name in names} == set(mf.__all__)
    assert "\n".join(communication.transmissions()) in communication.PAGE.read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
