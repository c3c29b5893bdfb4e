"""What holds for all tests.

A swarm in real time on a machine that itself stands still for seconds misses deadlines for which nothing here is to
blame: such a test says nothing. If it failed, and the machine did stand still meanwhile, it says so and is run again,
twice at the most. Any other failure is one at once, and so is that of a test without processes.
"""

import os
import signal
import threading
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import pytest

import tests.one_kernel  # noqa: F401  # isort: skip

from meanflock.swarm import plugins
from meanflock.swarm.plugins import registry
from tests.standstill import Standstill

hypothesis.settings.register_profile("untimed", deadline=None)  # how long an example takes is the machine's
hypothesis.settings.load_profile("untimed")


class MachineStoodStill(Exception):
    """The machine did, during a test that failed."""


# No other test has it: of each that may run again, a worker tells the first process and asks it, in 44 ms.
AGAIN = pytest.mark.flaky(reruns=2, only_rerun=[MachineStoodStill.__name__])


@pytest.fixture(scope="session", autouse=True)
def _temporary(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Processes that are killed leave temporary files: beside those of the tests, which pytest tidies up."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(tmp_path_factory.mktemp("temporary")))
        yield


def pytest_configure() -> None:
    """What a shell starts in the background ignores Ctrl-C, and so would all processes that the tests send one."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


OTHERS = {"PYTEST_CURRENT_TEST"}  # a variable that pytest sets


def _of_this_process() -> set[tuple[str, Any]]:
    """What a test could leave changed to those after it."""
    variables = {(name, said) for name, said in os.environ.items() if name not in OTHERS}
    signals = {(number.name, signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    return variables | signals | {("working folder", Path.cwd())}


@pytest.fixture(autouse=True)
def _left_as_found() -> Iterator[None]:
    before = _of_this_process()
    yield
    assert _of_this_process() ^ before == set(), "a test leaves to others what it changed"


@pytest.fixture(autouse=True)
def _no_plugin_stays(_left_as_found: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers ends with it, and so does the variable that names its file to processes started later."""
    monkeypatch.setattr(registry, "registered", dict(registry.registered))
    monkeypatch.setenv(plugins.FILES, os.environ.get(plugins.FILES, ""))


@cache
def _machine() -> Standstill:
    machine = Standstill()
    machine.start()
    return machine


def _judged(item: pytest.Item) -> Generator[None, Any, Any]:
    if item.get_closest_marker("processes") is None:
        return (yield)
    before = _machine().total_s
    try:
        return (yield)
    except (Exception, pytest.fail.Exception) as error:
        if (stood_s := _machine().total_s - before) > 0:
            raise MachineStoodStill(f"for {stood_s:.1f} s while this test ran, which failed") from error
        raise


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What starts processes comes last, when nothing else competes for the cores; the long trials of whole pages, which
    lie outside all rooms, first of those, so that no worker is left alone with them."""
    items.sort(key=lambda item: (item.get_closest_marker("processes") is not None, len(item.path.parts)))
    for item in items:
        if item.get_closest_marker("processes") is not None:
            item.add_marker(AGAIN)
    if config.getoption("loadgroup", False):  # this is a worker, and `--dist loadgroup` was asked for
        for item in items:
            _join(item)


def _join(item: pytest.Item) -> None:
    """One worker runs all tests of a file, so that it makes what they share once; of those that start processes, which
    are long, only the tests of an `xdist_group`.

    The scheduler knows a group by what stands behind the @ of a name. pytest-xdist writes it where pytest 9.2 does not
    look for it any more, and then spreads groups over all workers without a word.
    """
    group = item.get_closest_marker("xdist_group")
    if group is None and item.get_closest_marker("processes") is not None:
        return
    name = group.args[0] if group is not None else item.nodeid.partition("::")[0]
    item._id = type(item._id).parse(f"{item.nodeid}@{name}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, Any, Any]:
    return (yield from _judged(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    return (yield from _judged(item))
