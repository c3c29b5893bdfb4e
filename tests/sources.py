"""The modules of the project, as text and as trees; its requirements."""

import ast
import tomllib
from functools import cache
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "meanflock"
BESIDE = tuple(sorted(path.name for path in PACKAGE.iterdir() if path.is_symlink()))  # rooms at the top level
API = ("env", "testing")  # folders of the Python API
ROOMS = tuple(sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py") if path.parent.name not in API))
PROGRAMS = {f"meanflock.{room}.__main__" for room in ("agent", "leader", "worldsim", "groundstation")}
DOOR = sorted([*PACKAGE.glob("*.py"), *(path for name in API for path in (PACKAGE / name).rglob("*.py"))])
RESEARCH = sorted((ROOT / "research").rglob("*.py"))  # of the source, not of the package
MODULES = sorted(path for room in ROOMS for path in (PACKAGE / room).resolve().rglob("*.py")) + DOOR + RESEARCH
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(text(path), str(path))))


@cache
def imported(path: Path) -> set[str]:
    """Dotted names of every import in a module, wherever it stands."""
    names: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name_of(path)}:{node.lineno}: imports here are absolute"
            names.add(node.module or "")
    return names


def module_of(path: Path) -> str:
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    parts = parts if parts[0] in ("meanflock", "research") else ["meanflock", *parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {module_of(path): path for path in MODULES}


def needed(path: Path) -> set[str]:
    """The modules of ours that a module imports, type-checking imports included; a package only where a name of its own
    is taken, not on the way to one of its modules."""
    names: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            origins = {alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            names |= {name if name in NAMES else str(node.module) for name in origins.values()}
    return (names & set(NAMES)) - {module_of(path)}


def room_of(module: str) -> str:
    """The room a module belongs to; a program counts as the launcher's."""
    if module == "meanflock.__main__":
        return "cli"
    if module in PROGRAMS:
        return "launch"
    if module.split(".")[0] == "research":
        return "research"
    second = module.split(".")[1] if "." in module else ""
    return second if second in ROOMS else "meanflock"


def direct(*lists: list[str]) -> list[Requirement]:
    """The requirements of these lists, without the project's references to its own extras."""
    parsed = [Requirement(line) for requirements in lists for line in requirements]
    return [requirement for requirement in parsed if requirement.name != PROJECT["name"]]


def dotted(node: ast.AST) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


@cache
def used(path: Path) -> set[str]:
    """Dotted names of everything that a module calls or reads."""
    return {dotted(node) for node in nodes(path) if isinstance(node, ast.Attribute | ast.Name)}
