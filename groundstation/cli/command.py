"""The `meanflock` command: the group of all commands, and how every error becomes one line and an exit code."""

import logging
import os
import sys
import traceback
from io import TextIOWrapper

import click

from meanflock.groundstation.cli.fly import resume, run
from meanflock.groundstation.cli.leaderboard import leaderboard
from meanflock.groundstation.cli.look import picture, plot, view
from meanflock.groundstation.cli.prepare import certs_group, doctor, plugins_command, scenario_group
from meanflock.groundstation.cli.study import compare, paper, sweep
from meanflock.swarm import __version__, logs
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, MeanflockError, last_line
from meanflock.swarm.process import end


class _InOrder(click.Group):
    """Command group that lists commands in the order in which they were added."""

    def list_commands(self, _ctx: click.Context) -> list[str]:
        """Names in the order of addition."""
        return list(self.commands)


@click.group(cls=_InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
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


_FLY = (run, resume)
_LOOK = (view, picture, plot)
_STUDY = (compare, sweep, leaderboard, paper)
_PREPARE = (doctor, plugins_command, scenario_group, certs_group)
for _command in (*_FLY, *_LOOK, *_STUDY, *_PREPARE):
    cli.add_command(_command)


def _of_output(error: OSError) -> bool:
    """Whether the error is of standard output, as on a full disk; then its buffer is discarded."""
    *_, (innermost, _) = traceback.walk_tb(error.__traceback__)
    printed = str(innermost.f_globals.get("__name__")).partition(".")[0] in ("click", "rich")
    try:
        sys.stdout.flush()
    except OSError:
        printed = True
    if printed:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return printed


def main(arguments: list[str] | None = None) -> int:
    """The `meanflock` command: every error is one line and an exit code."""
    if arguments is None:
        os.environ["PYTHONSAFEPATH"] = "1"  # workers of a sweep do not import files of the working folder
        logs.divert()  # native code of libraries must not write to standard output
        if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="replace")  # a terminal that cannot show φ shows a question mark
    try:
        cli.main(arguments, prog_name="meanflock", standalone_mode=False)
        sys.stdout.flush()
        code = EXIT_DONE
    except MeanflockError as error:
        logs.tell(f"error: {error}", logging.ERROR)
        code = error.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(f"{error.format_message()}\n\nerror: name one of these commands", err=True)
        code = EXIT_BAD_INPUT
    except click.ClickException as error:
        place = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "meanflock"
        click.echo(f"error: {error.format_message()} See `{place} --help`.", err=True)
        code = EXIT_BAD_INPUT
    except click.Abort:
        logs.tell("error: interrupted", logging.ERROR)
        code = EXIT_RUN_FAILED
    except OSError as error:
        if not _of_output(error):
            raise
        logs.tell(f"error: standard output: {error.strerror}; what was flown or written is kept", logging.ERROR)
        code = EXIT_RUN_FAILED
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else EXIT_RUN_FAILED
    except BaseException as error:
        if isinstance(error, Exception):  # a defect of meanflock: show the traceback
            raise
        mend = "a plug-in must raise an Exception; what was flown is kept"
        logs.tell(f"error: the command was ended by {last_line(error)}; {mend}", logging.ERROR)
        code = EXIT_RUN_FAILED
    finally:
        logs.stop()
    if arguments is None:
        end(code)
    return code
