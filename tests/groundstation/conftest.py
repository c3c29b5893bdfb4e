"""What all tests of the ground station may use."""

import re
from collections.abc import Callable, Iterator

import pytest
import rerun as rr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from meanflock.cli.command import main

QUICK = ("run", "--in-process", "--no-record", "--quiet", "--uavs", "3", "--duration", "2")


@pytest.fixture
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures that were made, once for each file; no file is written: that takes longer than a short flight."""
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: figures.append(figure))
    return figures


@pytest.fixture
def run(tmp_path, capsys, monkeypatch) -> Callable[..., tuple[int, str, str]]:
    """Calls `meanflock ARGUMENTS` in an empty folder; returns exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str, str]:
        code = main(list(arguments))
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


def every_axis(figure: Figure) -> list[str]:
    """The labels of the panels, those a shared axis leaves to its neighbour not counted."""
    return [label for ax in figure.axes if ax.get_visible() for label in (ax.get_xlabel(), ax.get_ylabel()) if label]


def plain(title: str) -> str:
    """A title without its letter, line breaks and the dollars of mathematics."""
    words = re.sub(r"^\(\w\) ", "", title.replace("\n", " "))
    return words.replace("$", "").replace(r"\phi_", "φ_")


def titles(figure: Figure) -> dict[str, Axes]:
    return {plain(ax.get_title(loc="left")): ax for ax in figure.axes if ax.get_title(loc="left")}
