"""Arguments of several commands: scenario, output folder, and output of a flight.

Shell completion imports this module and those of the commands, so they import what flies only when they run.
"""

import json
import math
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meanflock.cli import completion
from meanflock.swarm import logs, paths
from meanflock.swarm.errors import meant

if TYPE_CHECKING:
    from meanflock.studies.lent_radio import LentRadio
    from meanflock.swarm.scenario import Scenario


class _Path(click.Path):
    """Type of all paths of the command line; see `paths.given`."""

    def convert(self, value: Any, _parameter: click.Parameter | None, _context: click.Context | None) -> Path:
        """The path, with the home folder in place of `~`."""
        return paths.given(value)


class CommandGroup(click.Group):
    """A group of commands that suggests the one that is meant, with every version of Click."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Find a command; an unknown one is an error that names the most similar."""
        names = self.list_commands(ctx)
        if args[0] not in names and not args[0].startswith("-") and not ctx.resilient_parsing:
            ctx.fail(f"No such command {args[0]!r}{meant(args[0], names) or '.'}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; an error of Click's parser, which knows no context, gets that of the command."""
        try:
            return super().invoke(ctx)
        except click.UsageError as error:
            if error.ctx is None and (name := ctx.invoked_subcommand) and (command := self.get_command(ctx, name)):
                error.ctx = click.Context(command, parent=ctx, info_name=name)
            raise


class _RunPath(_Path):
    """Type of the folder of a run, or of a recording: a path, or `latest`, unless there is a file of that name."""

    name = "run"

    def __init__(self, *, is_resumable: bool = False) -> None:
        """`is_resumable`: whether `latest` is the last run that can be resumed."""
        super().__init__()
        self._is_resumable = is_resumable

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Path:
        """The path of the run."""
        path = super().convert(value, parameter, context)
        if str(path) != completion.LATEST or os.path.lexists(path) or (context and context.resilient_parsing):
            return path
        from meanflock.results.stored_run import latest

        found = latest(completion.RUNS, is_resumable=self._is_resumable)
        logs.show(f"{completion.LATEST}: {found}")
        return found


PATH = _Path()
RUN = _RunPath()


def _register(context: click.Context, _parameter: click.Parameter, files: tuple[Path, ...]) -> None:
    if context.resilient_parsing:  # completion runs no code of plug-ins
        return
    from meanflock.swarm import plugins

    with redirect_stdout(sys.stderr):  # what they print is not what the command says
        plugins.load_files(files)
    context.meta[_PLUGINS] = files


def given_plugins() -> tuple[Path, ...]:
    """The files of `--plugin`."""
    files: tuple[Path, ...] = click.get_current_context().meta.get(_PLUGINS, ())
    return files


# in the `meta` of a context
_PLUGINS, _LEARNER, _UNTIL, _RADIO = "meanflock.plugins", "meanflock.learner", "meanflock.until", "meanflock.radio"


def _take_learner(context: click.Context, _parameter: click.Parameter, given: str | None) -> None:
    """Register the file of `--learner`, and keep its name; another name may be in a file of a later `--plugin`."""
    if given is None or context.resilient_parsing:
        return
    from meanflock.settings import learner_named

    with redirect_stdout(sys.stderr):
        context.meta[_LEARNER] = learner_named(given) if given.endswith(".py") else given


def given_learner() -> str | None:
    """Name of the learner of `--learner`; None without that option."""
    name: str | None = click.get_current_context().meta.get(_LEARNER)
    if name is None:
        return None
    from meanflock.settings import learner_named

    return learner_named(name)


def given_radio() -> "LentRadio | None":
    """The radio of `--radio`; None without that option."""
    radio: LentRadio | None = click.get_current_context().meta.get(_RADIO)
    return radio


def _take_until(context: click.Context, _parameter: click.Parameter, given: str | None) -> None:
    """Keep the bound of `--until` for `_with_flags`."""
    if given is not None:
        context.meta[_UNTIL] = given


def _take_radio(context: click.Context, _parameter: click.Parameter, given: Path | None) -> None:
    """Keep the radio of a scenario for `_with_flags`."""
    if given is None or context.resilient_parsing:
        return
    from meanflock.studies.lent_radio import lent_radio

    context.meta[_RADIO] = lent_radio(given)


def _with_flags(context: click.Context, _parameter: click.Parameter, settings: tuple[str, ...]) -> tuple[str, ...]:
    """The settings, after those of `--radio`, which they override; and those of `--learner` and `--until`."""
    if (radio := context.meta.get(_RADIO)) is not None:
        settings = (*radio.settings, *settings)
    for flag, key, value in (
        ("--learner", "training.learner", given_learner()),
        ("--until", "until", context.meta.get(_UNTIL)),
    ):
        if value is not None:
            from meanflock.studies.swept import refuse_setting

            refuse_setting(key, settings, f"is what {flag} says")
            settings = (*settings, f"{key}={json.dumps(value)}")
    return settings


class _MethodOption(click.Option):
    """Option `--method`, whose help names the controllers that are installed."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Search for the controllers, then write the help."""
        from meanflock.swarm import plugins

        self.help = f"The controller: {', '.join(plugins.names('controller'))}."
        return super().get_help_record(ctx)


_OF_A_SCENARIO = {
    "file": click.argument(
        "file", metavar="[SCENARIO]", required=False, type=PATH, shell_complete=completion.scenarios
    ),
    "method": click.option(
        "--method", cls=_MethodOption, metavar="NAME", help="The controller.", shell_complete=completion.controllers
    ),
    "uavs": click.option("--uavs", type=int, metavar="N", help="Number of UAVs."),
    "seed": click.option("--seed", type=int, metavar="S", help="Seed of all random numbers."),
    "duration": click.option("--duration", type=float, metavar="SECONDS", help="Longest simulated time of a flight."),
    "settings": click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="KEY=VALUE",
        shell_complete=completion.keys,
        callback=_with_flags,
        help="Set any key of the scenario, e.g. wind.sigma=0.2; repeatable.",
    ),
    "learner": click.option(
        "--learner",
        metavar="FILE.py|NAME",
        callback=_take_learner,
        expose_value=False,
        is_eager=True,  # before --set, which gets its key
        shell_complete=completion.learners,
        help="Train with a learner while UAVs fly; the controller must share no model.",
    ),
    "radio": click.option(
        "--radio",
        type=PATH,
        metavar="NAME|FILE",
        callback=_take_radio,
        expose_value=False,
        is_eager=True,  # before --set, which overrides it
        shell_complete=completion.scenarios,
        help="Fly with the radio of another scenario: [radio], [[stations]], federation.station and start.height.",
    ),
    "until": click.option(
        "--until",
        metavar="METRIC=VALUE",
        callback=_take_until,
        expose_value=False,
        is_eager=True,  # before --set, which gets its key
        help="End the flight with the round that reaches this mean over UAVs, e.g. accuracy=0.9 or loss<=0.3.",
    ),
    "plugin": click.option(
        "--plugin",
        multiple=True,
        type=PATH,
        metavar="FILE.py",
        callback=_register,
        expose_value=False,
        is_eager=True,  # before anything asks for what is in it
        help="Load your own controller, aggregation rule, channel, vehicle, learner, filter or coding; repeatable.",
    ),
}


def scenario_arguments(*names: str) -> Callable[[Any], Any]:
    """Decorator that adds the arguments of a scenario: all of them, or those named."""

    def decorate(command: Any) -> Any:
        for name in reversed(names or tuple(_OF_A_SCENARIO)):
            command = _OF_A_SCENARIO[name](command)
        return command

    return decorate


def load_scenario(file: Path | None, settings: Iterable[str], **options: Any) -> "Scenario":
    """Load the scenario of these arguments.

    Raises:
        BadInput: a scenario that cannot be flown here, or a key that is set both by a flag and by `--set`.
    """
    from meanflock.settings import check_flyable
    from meanflock.studies.swept import refuse_method, refuse_setting
    from meanflock.swarm import scenario

    for key, value in options.items():
        if value is not None:
            refuse_setting(key, settings, f"is what --{key} says")
    flown = scenario.load(file, settings, **options)
    if options.get("method") is not None or "method" in (setting.partition("=")[0].strip() for setting in settings):
        refuse_method(flown)
    check_flyable(flown, str(file or "scenario"))
    return flown


class Positive(click.FloatRange):
    """Option with a finite number of at least 0; `above`: more than 0."""

    def __init__(self, *, above: bool = False) -> None:
        super().__init__(0.0, min_open=above)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse a number; NaN is within every range of Click."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


def number_option(flag: str, metavar: str, default: int, about: str, least: int = 1, most: int | None = None) -> Any:
    """Option with a whole number and a default."""
    kind = click.IntRange(least, most)
    return click.option(flag, type=kind, default=default, show_default=True, metavar=metavar, help=about)


def out_option(default: str, about: str = "Where results are written.") -> Callable[[Any], Any]:
    """Option `--out` with a default folder."""
    return click.option("--out", type=PATH, default=Path(default), show_default=True, metavar="DIR", help=about)


def report(paths: Iterable[Path]) -> None:
    """Print which files were written."""
    for path in paths:
        click.echo(str(path))


run_argument = click.argument("folder", metavar="RUN", type=RUN, shell_complete=completion.runs)
unfinished_run_argument = click.argument(
    "folder", metavar="RUN", type=_RunPath(is_resumable=True), shell_complete=completion.runs
)
quiet_option = click.option("--quiet", is_flag=True, help="Show no progress bar.")
uavs_per_process_option = number_option("--uavs-per-process", "M", 1, "UAVs that one agent process flies.")
in_process_option = click.option("--in-process", is_flag=True, help="Fly in this process, without the network.")
tls_option = click.option(
    "--tls", type=PATH, metavar="DIR", help="Use mutual TLS, with certificates of `meanflock certs init`."
)

_TOLD = (
    click.option(
        "--metrics",
        envvar="MEANFLOCK_METRICS",
        metavar="[HOST:]PORT",
        help="Serve metrics to Prometheus here; port 0: any free one.",
    ),
    click.option(
        "--log-format",
        type=click.Choice((logs.TEXT, logs.JSON)),
        envvar="MEANFLOCK_LOG_FORMAT",
        help="Print the logs of all processes on stderr; with json, nothing else.",
    ),
    click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object on stdout."),
    quiet_option,
)


def telling(command: Any) -> Any:
    """Decorator that adds the options of a flight's output."""
    for option in reversed(_TOLD):
        command = option(command)
    return command
