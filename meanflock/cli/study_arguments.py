"""Options of the commands that fly many times, their progress bar, and their store of flights."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import click
from click.shell_completion import CompletionItem

from meanflock.cli import completion
from meanflock.cli.arguments import PATH
from meanflock.swarm.durable import check_folder
from meanflock.swarm.errors import BadInput

if TYPE_CHECKING:
    from meanflock.studies.runner import Jobs
    from meanflock.studies.store import Store

F = TypeVar("F", bound=Callable[..., Any])
Complete = Callable[[click.Context, click.Parameter, str], list[str] | list[CompletionItem]]
SEEDS = 8
_TAKING = "meanflock.taking"  # the list option at the end of the words, if any
seeds_option = click.option(
    "--seeds", type=click.IntRange(1), metavar="K", help=f"Flights of each, with one seed each.  [default: {SEEDS}]"
)


def _number_of_jobs(_context: click.Context, _option: click.Parameter, jobs: int) -> int:
    if jobs == 0:
        raise BadInput("--jobs 0: give a number of processes, or -1 for one a core")
    return jobs


scenario_option = click.option(
    "--scenario",
    "file",
    type=PATH,
    metavar="SCENARIO",
    shell_complete=completion.scenarios,
    help="A TOML file, or the name of a shipped scenario.  [default: the paper's]",
)
FORMATS = ("pdf", "png", "svg")  # a test compares them with those of the plots


def _formats(_context: click.Context, _option: click.Parameter, given: str) -> tuple[str, ...]:
    found = tuple(dict.fromkeys(names([given])))
    if not found or not {*found} <= {*FORMATS}:
        raise BadInput(f"--figures {given}: name formats, of {', '.join(FORMATS)}, with commas between")
    return found


def _two_fields(_context: click.Context, _option: click.Parameter, given: tuple[str, str] | None) -> Any:
    if given and given[1].startswith("-"):  # Click takes the next option for the second field
        raise BadInput(f"--pareto {given[0]}: it takes two fields; write for example --pareto {given[0]} collisions")
    return given


def _as_one(name: str, kind: Any, *options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Decorator that adds options; the command gets the tuple `kind` of their values as `name`."""

    def decorate(command: Callable[..., None]) -> Any:
        @wraps(command)
        def call(**given: Any) -> None:
            own = kind(**{field: given.pop(field) for field in kind._fields})
            command(**{name: own}, **given)

        added: Any = call
        for option in reversed(options):
            added = option(added)
        return added

    return decorate


class ResultsOptions(NamedTuple):
    """The results of a study that the options ask for. pareto: two fields. columns: printed columns of a figure."""

    pareto: tuple[str, str] | None
    figures: tuple[str, ...]
    columns: int
    over: str


results_options = _as_one(
    "wanted",
    ResultsOptions,
    click.option(
        "--pareto",
        nargs=2,
        metavar="X Y",
        callback=_two_fields,
        help="Find the Pareto front of two fields, e.g. bits accuracy, or energy_mean_J collisions.",
    ),
    click.option(
        "--figures",
        default="png,svg",
        show_default=True,
        metavar="FORMATS",
        callback=_formats,
        help="Formats of the figures: pdf, png, svg.",
    ),
    click.option(
        "--columns",
        type=click.Choice(("1", "2")),
        default="2",
        show_default=True,
        callback=lambda _context, _option, columns: int(columns),
        help="Width of the figures in print: one column, 3.5 in, or two, 7.16 in.",
    ),
    click.option(
        "--over",
        type=click.Choice(("rounds", "seconds", "bits", "airtime")),
        default="rounds",
        show_default=True,
        help="What learning curves are drawn over.",
    ),
)


class WorkersOptions(NamedTuple):
    """The workers that the options ask for; see `meanflock.studies.runner.workers`."""

    jobs: int
    backend: str
    scheduler: str | None

    def start(self) -> "AbstractContextManager[Jobs]":
        """Context with the workers.

        Raises:
            BadInput: there are no such workers.
        """
        from meanflock.studies.runner import workers

        return workers(self.backend, self.scheduler, self.jobs)


workers_options = _as_one(
    "workers",
    WorkersOptions,
    click.option(
        "--jobs",
        type=int,
        default=-1,
        metavar="J",
        help="Processes that fly at once; -1: one per core.  [default: -1]",
        callback=_number_of_jobs,
    ),
    click.option(
        "--backend",
        type=click.Choice(("processes", "dask")),
        default="processes",
        show_default=True,
        help="Processes of this machine, or a Dask cluster.",
    ),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler, e.g. tcp://127.0.0.1:8786.  [default: a cluster on this machine]",
    ),
)


@contextmanager
def progress_of(title: str, quiet: bool, units: str = "runs") -> Iterator[Callable[[int, int], None]]:
    """Progress bar with the time left, on stderr; called with the numbers of finished and of all units."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    bar = Progress(
        TextColumn(f"[bold]{title}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TextColumn(units),
        TimeRemainingColumn(compact=True),
        console=console,
        disable=quiet or not console.is_terminal,
        transient=True,
    )
    with bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def store_in(out: Path) -> Iterator["Store"]:
    """Store of flights in `out`. If none could be flown, new folders are removed."""
    from meanflock.launch.doctor import tell_if_slow
    from meanflock.studies.store import Store

    new = not out.exists()
    store = Store(out)
    check_folder(out, "--out")
    tell_if_slow()
    try:
        yield store
    except BadInput:  # nothing was flown: only empty folders are removed
        for folder in (store.data / "jobs", store.data, *([out] if new else [])):
            with suppress(OSError):
                folder.rmdir()
        raise


def list_option(
    flag: str,
    metavar: str,
    about: str,
    default_text: str,
    complete: Complete | None = None,
    default: tuple[str, ...] | None = None,
) -> Callable[[F], F]:
    """An option of a command of `lists`. `default_text`: the default in its help."""
    text = f"{about}.  [default: {default_text}]"
    return click.option(flag, multiple=True, default=default, metavar=metavar, help=text, shell_complete=complete)


def lists(*flags: str) -> type[click.Command]:
    """A kind of command whose list options take all words up to the next option: `--missions paper swap --seeds 2`.

    A word with = in it, as a key and its values, is none of a list.
    """

    class Lists(click.Command):
        def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
            """Repeat the option before each of its words."""
            given: list[str] = []
            taking = ""
            for word in args:
                if word.startswith("-"):
                    taking = word if word in flags else ""
                    given += [] if taking else [word]
                else:
                    given += [taking, word] if taking and "=" not in word else [word]
            ctx.meta[_TAKING] = taking
            for flag in () if ctx.resilient_parsing else flags:
                if flag in args and flag not in given and not any(word.startswith(f"{flag}=") for word in args):
                    raise BadInput(f"{flag}: name one or more, or all")
            return super().parse_args(ctx, given)

        def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
            """Complete the second and later words of a list like its first."""
            return [*super().shell_complete(ctx, incomplete), *_of_list(ctx, incomplete)]

    return Lists


def keys_or_list(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completion of an argument with keys, in a command of `lists`: its keys, and words of the list at the end."""
    return [*completion.keys(context, parameter, incomplete), *_of_list(context, incomplete)]


def _of_list(context: click.Context, incomplete: str) -> list[CompletionItem]:
    """Completion of the list option at the end of the words, if any."""
    options = [option for option in context.command.params if context.meta[_TAKING] in option.opts]
    return [item for option in options for item in option.shell_complete(context, incomplete)]


def names(given: Sequence[str]) -> list[str]:
    """Split a list at spaces and commas."""
    return [name for word in given for name in word.replace(",", " ").split()]
