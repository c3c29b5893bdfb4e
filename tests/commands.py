"""Commands in processes of their own, and what they print."""

import subprocess
import sys
from typing import Any

from tests.polling import DEADLINE_S

COMMAND = (sys.executable, "-m", "meanflock.cli")


def ended(*line: object, **options: Any) -> "subprocess.CompletedProcess[str]":
    given = {"capture_output": True, "text": True, "timeout": DEADLINE_S} | options
    return subprocess.run([*map(str, line)], **given)


def loaded(code: str, **options: Any) -> set[str]:
    """The modules and packages that a process has loaded that has run `code`."""
    tells = "\nimport sys\nprint('modules:', *(name for name in sys.modules if sys.modules[name]), file=sys.stderr)"
    done = ended(sys.executable, "-c", code + tells, **options)
    assert done.returncode == 0, done.stderr
    names = done.stderr.partition("modules: ")[2].split()
    return {*names, *(name.split(".")[0] for name in names)}


def printed(*line: object, **options: Any) -> str:
    """Standard output of a command that must end well."""
    done = ended(*line, **options)
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout
