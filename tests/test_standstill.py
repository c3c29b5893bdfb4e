"""How the tests run: a test of processes that fails in a standstill is repeated, and groups stay together."""

from pathlib import Path

import pytest

from tests.standstill import LOOK_S, NOTABLE_S, Standstill

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[1]
FAIL_ONCE = """
import threading
import pytest

tries = set()

def fail_once(name, late_s):
    watch = [thread for thread in threading.enumerate() if thread.name == "standstill"]
    if watch:
        watch[0].note(late_s)
    if name not in tries:
        tries.add(name)
        pytest.fail("once")

@pytest.mark.processes
def test_of_processes_in_a_standstill():
    fail_once("standstill", 3.0)

@pytest.mark.processes
def test_of_processes():
    fail_once("processes", 0.1)

def test_without_processes():
    fail_once("none", 3.0)
"""


def test_only_a_test_of_processes_in_a_standstill_is_repeated(pytester, monkeypatch) -> None:
    machine = Standstill()
    for late_s in (0.0, LOOK_S, NOTABLE_S, 1.5, 2.0):
        machine.note(late_s)
    assert machine.total_s == pytest.approx(3.5)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makepyprojecttoml((ROOT / "pyproject.toml").read_text())
    pytester.makeconftest((ROOT / "tests" / "conftest.py").read_text())
    ran = pytester.runpytest_subprocess(pytester.makepyfile(FAIL_ONCE))
    assert ran.parseoutcomes() == {"passed": 1, "rerun": 1, "failed": 2}
