"""A test of processes that fails while the machine stands still is run again; no other is."""

from pathlib import Path

import pytest

from tests.standstill import LOOK_S, NOTABLE_S, Standstill

pytest_plugins = ["pytester"]

FAILS_ONCE = """
import threading
import pytest

tries = []

@pytest.mark.processes
def test_that_has_the_machine_watched():
    pass

{mark}
def test_that_fails_once():
    next(thread for thread in threading.enumerate() if thread.name == "standstill").note({late_s})
    tries.append(1)
    assert len(tries) > 1
"""


def test_only_what_is_notable_counts() -> None:
    machine = Standstill()
    for late_s in (0.0, LOOK_S, NOTABLE_S, 1.5, 2.0):
        machine.note(late_s)
    assert machine.total_s == pytest.approx(3.5)


@pytest.mark.parametrize(
    ("mark", "late_s", "outcomes"),
    [
        ("@pytest.mark.processes", 3.0, {"passed": 2, "rerun": 1}),
        ("@pytest.mark.processes", 0.1, {"passed": 1, "failed": 1}),
        ("", 3.0, {"passed": 1, "failed": 1}),
    ],
)
def test_who_failed_while_the_machine_stood_still_runs_again(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, mark: str, late_s: float, outcomes: dict[str, int]
) -> None:
    root = Path(__file__).parents[1]
    monkeypatch.setenv("PYTHONPATH", str(root))
    pytester.makepyprojecttoml((root / "pyproject.toml").read_text())
    pytester.makeconftest((root / "tests" / "conftest.py").read_text())
    ran = pytester.runpytest_subprocess(pytester.makepyfile(FAILS_ONCE.format(mark=mark, late_s=late_s)))
    assert ran.parseoutcomes() == outcomes
