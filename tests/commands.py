"""Commands in processes of their own, and what they print."""

import subprocess
import sys
from typing import Any

from tests.polling import DEADLINE_S

COMMAND = (sys.executable, "-m", "meanflock.groundstation.cli")


def ended(*line: object, **options: Any) -> "subprocess.CompletedProcess[str]":
    given = {"capture_output": True, "text": True, "timeout": DEADLINE_S} | options
    return subprocess.run([*map(str, line)], **given)


def printed(*line: object, **options: Any) -> str:
    """Standard output of a command that must end well."""
    done = ended(*line, **options)
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout
