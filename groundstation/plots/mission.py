"""What a plot of paths shows of the mission: goals, obstacles; read from the run, whatever is installed."""

from pathlib import Path

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from msgspec import field

from meanflock.groundstation.plots import plotstyle
from meanflock.groundstation.results.run_folder import SCENARIO
from meanflock.swarm import mission, toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Destination, Metrics, Obstacle, Start


class Flown(msgspec.Struct):
    """What a plot says of a scenario; that can be read where its controller is not installed."""

    method: str = ""  # where there is no scenario
    seed: int = 0
    uavs: int = 1
    dt: float = 0.1
    start: Start = field(default_factory=Start)
    destination: Destination = field(default_factory=Destination)
    metrics: Metrics = field(default_factory=Metrics)
    obstacles: tuple[Obstacle, ...] = ()


def flown(folder: Path) -> Flown:
    """Of the run in a folder.

    Raises:
        BadInput: its scenario is damaged.
    """
    path = folder / SCENARIO
    if not path.is_file():
        return Flown()
    try:
        return msgspec.convert(toml.read(path, "scenario file"), Flown)
    except msgspec.ValidationError as error:
        raise BadInput(f"{path}: {error}; take it from the folder of a run") from error


def draw(ax: Axes, of: Flown) -> None:
    """Draws goals and obstacles, on top of what ends there, and names them in the legend."""
    goals, radius = mission.goals(of), of.destination.radius
    for x, y, size in mission.obstacles(of).tolist():
        ax.add_patch(Circle((x, y), size, facecolor=plotstyle.PALE, edgecolor=plotstyle.INK, linewidth=0.5, zorder=0.9))
    if len(of.obstacles):
        ax.plot([], [], linestyle="", marker="o", color=plotstyle.PALE, label="obstacles")
    if (goals == goals[0]).all():
        for width, color in ((3.2, "white"), (1.6, plotstyle.GOAL)):  # what ends in it must not hide it
            ax.add_patch(Circle(tuple(goals[0]), radius, fill=False, edgecolor=color, linewidth=width, zorder=5))
        ax.plot([], [], **plotstyle.RING, label=f"goal, {radius:g} m")
    else:
        marks = np.unique(goals, axis=0)
        ax.plot(*marks.T, linestyle="", marker="x", markersize=2.4, color=plotstyle.GOAL, zorder=5, label="goals")
