"""The `meanflock` command: the group of all commands, and how every error becomes one line and an exit code."""

import codecs
import logging
import os
import sys
import traceback
from importlib import import_module
from io import TextIOWrapper
from typing import Any, NamedTuple

import click
from click.shell_completion import CompletionItem

from meanflock.cli import completion
from meanflock.cli.arguments import CommandGroup
from meanflock.swarm import __version__, logs
from meanflock.swarm.ending import end
from meanflock.swarm.errors import (
    EXIT_BAD_INPUT,
    EXIT_DONE,
    EXIT_RUN_FAILED,
    BadInput,
    MeanflockError,
    lacking,
    last_line,
)


class _Listed(NamedTuple):
    """Module of a command, and its line in the list of commands, which is the first of its help."""

    module: str
    attribute: str
    line: str


_COMMANDS = {  # in the order of their use
    "run": _Listed("fly", "run", "Fly a scenario once, by default the paper's."),
    "resume": _Listed("fly", "resume", "Resume a run that did not finish, from its last checkpoint."),
    "view": _Listed("look", "view", "Open a finished run in the Rerun viewer."),
    "picture": _Listed("look", "picture", "Save the Rerun view of a finished run as a PNG file."),
    "plot": _Listed("look", "plot", "Plot paths and time series of a run, or write them as CSV."),
    "list": _Listed("runs", "list_runs", "List the runs in a folder, the latest first."),
    "show": _Listed("runs", "show", "Show a run: what was flown, what came of it, and its files."),
    "diff": _Listed("runs", "diff", "Compare two runs: which keys and which figures differ."),
    "export": _Listed("export", "export", "Write a run for Foxglove and ROS 2, or its radio as a table."),
    "bridge": _Listed("bridge", "bridge", "Show a flight to other software, live or from a run folder."),
    "flower": _Listed("flower", "flower", "Fly a Flower app unmodified: the radio carries its models."),
    "compare": _Listed("study", "compare", "Compare controllers over the same seeds."),
    "sweep": _Listed("study", "sweep", "Compare several values of one scenario key, or of several."),
    "study": _Listed("rerun", "study_group", "Fly a study again, and say whether it is the same."),
    "leaderboard": _Listed("leaderboard", "leaderboard", "Rank controllers over the same missions and seeds."),
    "frontier": _Listed("frontier", "frontier", "Find the fewest bits to send for flights without collisions."),
    "paper": _Listed("study", "paper", "Repeat the paper's experiments and test its claims."),
    "doctor": _Listed("prepare", "doctor", "Check whether a run would work on this machine."),
    "plugins": _Listed("prepare", "plugins_command", "List controllers and all other plug-ins, with their options."),
    "new": _Listed("new", "new", "Write a package for your own controller or other plug-in."),
    "scenario": _Listed("prepare", "scenario_group", "Print a scenario, or the schema of scenario files."),
    "certs": _Listed("prepare", "certs_group", "Make TLS certificates for the nodes of a swarm."),
}


class _LazyGroup(CommandGroup):
    """Command group that imports the module of a command when the command is used; listing commands imports none."""

    def list_commands(self, _ctx: click.Context) -> list[str]:
        """Names in the order of the table."""
        return list(_COMMANDS)

    def get_command(self, _ctx: click.Context, name: str) -> click.Command | None:
        """Import a command; None if there is no such command."""
        if name not in _COMMANDS:
            return None
        listed = _COMMANDS[name]
        command: click.Command = getattr(import_module(f"meanflock.cli.{listed.module}"), listed.attribute)
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; a library that it lacks is bad input, and the message says what to install."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            if what := lacking(error, f"`meanflock {ctx.invoked_subcommand}`", "ground"):
                raise BadInput(what) from error
            raise

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Names of commands with their lines, and options."""
        names = [name for name in _COMMANDS if name.startswith(incomplete)]
        items = [CompletionItem(name, help=_COMMANDS[name].line) for name in names]
        return [*items, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, _ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, listed.line) for name, listed in _COMMANDS.items()])


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="meanflock")
def cli() -> None:
    """Fly swarms of UAVs that learn in flight, over a simulated radio on which every bit is counted.

    \b
    Example: meanflock run --method mfgfl-hf --seed 7

    \b
    Exit codes:
      0  done
      1  the run failed or was interrupted
      2  bad input; nothing was written
    """


def _of_output(error: OSError) -> bool:
    """Returns whether the error is of standard output, as on a full disk; then its buffer is discarded."""
    *_, (innermost, _) = traceback.walk_tb(error.__traceback__)
    printed = str(innermost.f_globals.get("__name__")).partition(".")[0] in ("click", "rich")
    try:
        sys.stdout.flush()
    except OSError:
        printed = True
    if printed:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return printed


def _question_marks(error: UnicodeError) -> tuple[bytes, int]:
    """Bytes in place of characters that standard output cannot show: a question mark, as of φ in the locale C.

    Bytes of a path that are not text, which Python holds as surrogates, are written as they are.
    """
    assert isinstance(error, UnicodeEncodeError)
    codes = map(ord, error.object[error.start : error.end])
    return bytes(code - 0xDC00 if 0xDC80 <= code <= 0xDCFF else ord("?") for code in codes), error.end


def main(arguments: list[str] | None = None) -> int:
    """The `meanflock` command: every error is one line and an exit code."""
    completes = arguments is None and completion.asked()
    if completes:
        completion.install()
    elif arguments is None:
        os.environ["PYTHONSAFEPATH"] = "1"  # workers of a sweep do not import files of the working folder
        os.environ["MPLBACKEND"] = "agg"  # a notebook sets one that may not be installed here
        logs.divert()  # native code of libraries must not write to standard output
        if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors in ("strict", "surrogateescape"):
            codecs.register_error("meanflock", _question_marks)
            sys.stdout.reconfigure(errors="meanflock")
    try:
        words = tuple(sys.argv[1:] if arguments is None else arguments)
        cli.main(arguments, prog_name="meanflock", standalone_mode=False, obj=words)
        sys.stdout.flush()
        code = EXIT_DONE
    except MeanflockError as error:
        logs.show(f"error: {error}", logging.ERROR)
        code = error.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(f"{error.format_message()}\n\nerror: name one of these commands", err=True)
        code = EXIT_BAD_INPUT
    except click.ClickException as error:
        place = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "meanflock"
        what = error.format_message()
        click.echo(f"error: {what}{'' if what.endswith(('.', '?')) else '.'} See `{place} --help`.", err=True)
        code = EXIT_BAD_INPUT
    except click.Abort:
        logs.show("error: interrupted", logging.ERROR)
        code = EXIT_RUN_FAILED
    except OSError as error:
        if not _of_output(error):
            raise
        logs.show(f"error: standard output: {error.strerror}; what was flown or written is kept", logging.ERROR)
        code = EXIT_RUN_FAILED
    except MemoryError as error:
        logs.show(f"error: out of memory: {error}; fly fewer UAVs; what was flown is kept", logging.ERROR)
        code = EXIT_RUN_FAILED
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else EXIT_RUN_FAILED
    except BaseException as error:
        if isinstance(error, Exception):  # a defect of meanflock: show the traceback
            raise
        remedy = "a plug-in must raise an Exception; what was flown is kept"
        logs.show(f"error: the command was ended by {last_line(error)}; {remedy}", logging.ERROR)
        code = EXIT_RUN_FAILED
    finally:
        logs.stop()
    if arguments is None and not completes:
        end(code)
    return code
