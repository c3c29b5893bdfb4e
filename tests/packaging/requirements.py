"""The requirements of the project, as pyproject.toml has them."""

import tomllib

from packaging.requirements import Requirement

from tests.sources import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]


def direct(*lists: list[str]) -> list[Requirement]:
    """The requirements of these lists, without the project's references to its own extras."""
    parsed = [Requirement(line) for requirements in lists for line in requirements]
    return [requirement for requirement in parsed if requirement.name != PROJECT["name"]]
