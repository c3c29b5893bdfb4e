"""Signals while processes of a study start, and a pool that is killed at once."""

import signal
import subprocess
import sys

import pytest

from tests.polling import DEADLINE_S

_START = """
import signal, sys
from pathlib import Path
from meanflock.studies.backends import _unbroken, terminable
from meanflock.swarm.errors import RunFailed
number = int(sys.argv[1])
signal.signal(signal.SIGINT, signal.default_int_handler)
before = signal.getsignal(number)
try:
    with terminable(Path("there")), _unbroken():
        signal.raise_signal(number)
        signal.raise_signal(number)
        print("finished")
except RunFailed as error:
    print(error, signal.getsignal(number) == before)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_must_not_be_broken_off_is_finished_first(number: signal.Signals) -> None:
    """In a process of its own: signals to that of the tests would end more than this one."""
    command = [sys.executable, "-c", _START, str(int(number))]
    said = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=True).stdout
    assert said.splitlines() == [
        "finished",
        "interrupted; flights that were finished are kept in there/data: repeat the command to go on True",
    ]


_KILL = """
import time
import warnings
import joblib
from meanflock.studies.pool import Pool
if __name__ == "__main__":
    warnings.simplefilter("ignore")  # that some results were not fetched
    for _ in range(20):  # of which some are killed before their calls are on the way
        parallel = joblib.Parallel(n_jobs=2, backend=Pool(), return_as="generator_unordered", batch_size=1)
        parallel(joblib.delayed(time.sleep)(10) for _ in range(9)).close()
"""


def test_a_pool_that_is_killed_at_once_says_nothing() -> None:
    command = [sys.executable, "-c", _KILL]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
