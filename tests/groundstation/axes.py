"""The axes of a figure."""

from matplotlib.figure import Figure


def every_axis(made: Figure) -> list[str]:
    """The labels of the panels, those a shared axis leaves to its neighbour not counted."""
    return [label for ax in made.axes if ax.get_visible() for label in (ax.get_xlabel(), ax.get_ylabel()) if label]
