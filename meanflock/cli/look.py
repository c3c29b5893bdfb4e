"""Commands that look at a run: view, picture, plot."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from meanflock.cli.arguments import PATH, quiet_option, report, run_argument
from meanflock.cli.study_arguments import progress_of
from meanflock.swarm.errors import BadInput

if TYPE_CHECKING:
    from meanflock.results.timeseries_file import Per


@click.command()
@run_argument
@click.option("--web", is_flag=True, help="Serve it to a browser, at the address printed; needs no display.")
def view(folder: Path, web: bool) -> None:
    """Open a finished run in the Rerun viewer.

    RUN is its folder, `latest`, or a file.rrd. Ends when the window is closed, or with Ctrl-C.

    \b
    Example: meanflock view runs/20261121-101500-mfgfl-hf-s7
    """
    from meanflock.cli import display
    from meanflock.recording import viewer

    path = _recording(folder)
    if not web:
        display.check(
            f"try `meanflock view {folder} --web` with a browser, or `meanflock picture {folder} -o FILE.png`"
        )
        _complete(folder, path)
        viewer.attend(viewer.open_viewer(path))
        return
    from meanflock.recording.web import WebPage

    _complete(folder, path)
    with WebPage(path) as page:
        click.echo(f"{page.url}\nCtrl-C ends it.")
        page.attend()


@click.command()
@run_argument
@click.option(
    "--at", "at_s", type=float, metavar="SECONDS", help="Simulated time to draw.  [default: the end of the flight]"
)
@click.option("-o", "--output", "png", required=True, type=PATH, metavar="FILE.png", help="File to write.")
@click.option("--size", default="1920x1080", show_default=True, metavar="WIDTHxHEIGHT", help="Size in pixels.")
@click.option(
    "--view",
    type=click.Choice(("all", "map", "space")),
    default="all",
    show_default=True,
    help="Show the map alone, or the view in space.",
)
def picture(folder: Path, at_s: float | None, png: Path, size: str, view: str) -> None:
    """Save the Rerun view of a finished run as a PNG file.

    RUN is its folder, `latest`, or a file.rrd. Needs no display.

    \b
    Example:
      meanflock picture runs/20261121-101500-mfgfl-hf-s7 --at 40 -o swarm.png
      meanflock picture latest --view space -o out/space.png
    """
    from meanflock.recording.viewer import pixels, screenshot

    wanted = pixels(size)
    if png.suffix.lower() != ".png":
        raise BadInput(f"-o {png}: give it a name that ends in .png")
    path = _recording(folder)
    _complete(folder, path)
    screenshot(path, png, at_s, wanted, view)
    click.echo(str(png))


@click.command()
@run_argument
@click.option(
    "--csv",
    "csv_file",
    type=PATH,
    metavar="FILE.csv",
    help="Write the time series to this file instead of plots.",
)
@click.option(
    "--per", type=click.Choice(("uav", "tick")), help="Rows of that file: tick and UAV, or tick.  [default: uav]"
)
@click.option(
    "--over",
    type=click.Choice(("rounds", "seconds", "bits", "airtime")),
    help="Plot learning curves over these instead.",
)
@click.option("--out", type=PATH, metavar="DIR", help="Where plots are written.  [default: RUN/plots]")
@quiet_option
def plot(
    folder: Path, csv_file: Path | None, per: "Per | None", over: str | None, out: Path | None, quiet: bool
) -> None:
    """Plot paths and time series of a run, or write them as CSV.

    RUN is its folder, or `latest`; the plots are written as PNG and SVG. A run that cannot be written needs --out. With
    --over they are learning curves: the diagnostics and metrics at the end of each round.

    \b
    Example: meanflock plot runs/20261121-101500-mfgfl-hf-s7
    """
    if csv_file is None:  # first: without Matplotlib nothing is written
        from meanflock.results.plots import plotstyle
        from meanflock.results.plots.rounds import plot_rounds
        from meanflock.results.plots.run import plot_run
    from meanflock.results.run_folder import alone, completed, flown_rows
    from meanflock.results.timeseries_file import write_csv

    if not folder.is_dir():
        raise BadInput(f"{folder}: no such run; name the folder of one")
    if over is not None and csv_file is not None:
        raise BadInput("--over and --csv: give one of them")
    if per is not None and csv_file is None:
        raise BadInput(f"--per {per}: it is about the rows of --csv FILE.csv; give that too")
    if out is not None and csv_file is not None:
        raise BadInput(f"--out {out}: it is where plots are written, and --csv FILE.csv writes none; leave one out")
    with alone(folder):
        completed(folder)
    if csv_file is not None:
        with progress_of("writing", quiet, "ticks") as show:
            written = [write_csv(flown_rows(folder), csv_file, per or "uav", show)]
    else:
        figures = plot_run(folder) if over is None else plot_rounds(folder, over)
        written = plotstyle.write(figures, out or folder / "plots")
    report(written)


def _recording(folder: Path) -> Path:
    from meanflock.results.run_folder import RECORDING

    path = folder if folder.suffix == ".rrd" else folder / RECORDING
    if not path.is_file():
        raise BadInput(f"{path}: no recording; name the folder of a run that was recorded")
    return path


def _complete(folder: Path, path: Path) -> None:
    """Complete the recording of a killed run from its time series.

    Raises:
        BadInput: the run lacks a file for that, or `path` is a recording alone that was cut off or is damaged.
    """
    from meanflock.recording.replay import complete, verify
    from meanflock.results.run_folder import alone, completed

    if folder.is_dir():
        with alone(folder):
            completed(folder)
            complete(folder)
    elif verify(path) is not None:
        raise BadInput(f"{path}: cut off or damaged; name the folder of its run, from whose rows it is completed")
