"""Rules for all tests.

A test of processes that fails while the machine stands still for seconds is repeated, twice at most. Any other failure
counts.
"""

import gc
import os
import signal
import threading
import time
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import pytest

import tests.one_kernel  # noqa: F401  # isort: skip

from meanflock.swarm import plugins
from meanflock.swarm.plugins import registry
from tests.faults.by_hand import Processes

hypothesis.settings.register_profile("untimed", deadline=None)  # how long an example takes is the machine's
hypothesis.settings.load_profile("untimed")


class MachineStoodStill(Exception):
    """The machine stood still while a test ran that failed."""


AGAIN = pytest.mark.flaky(reruns=2, only_rerun=[MachineStoodStill.__name__])


@pytest.fixture(scope="session", autouse=True)
def _temporary(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Temporary files of killed processes lie beside those of the tests, which pytest removes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(tmp_path_factory.mktemp("temporary")))
        yield


def pytest_configure() -> None:
    """Processes that a shell starts in the background ignore Ctrl-C; those of the tests must not.

    Collection makes half a million objects that stay: a third of its time would be a search for garbage among them.
    """
    gc.disable()
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _of_this_process() -> set[tuple[str, Any]]:
    """What a test could leave changed to those after it."""
    once = (
        "PYTEST_CURRENT_TEST",
        "ZENOH_RUNTIME",
        "PYGAME_HIDE_SUPPORT_PROMPT",
        "SDL_AUDIODRIVER",
    )  # by pytest; by libraries when loaded
    variables = {(name, value) for name, value in os.environ.items() if name not in once}
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


@pytest.fixture
def processes() -> Iterator[Processes]:
    """World, leaders, agents and stations that a test starts by hand; they are killed at its end."""
    started = Processes(f"by-hand-{os.getpid()}")
    yield started
    started.close()


LATE_S: list[float] = []  # by how much the watch came late, where that is notable; a barrier waits for 2 s


def _watch() -> None:
    """Looks twenty times a second: a virtual machine stands still for seconds when its neighbours are busy."""
    while True:
        before = time.monotonic()
        time.sleep(0.05)
        if (late_s := time.monotonic() - before - 0.05) > 0.5:
            LATE_S.append(late_s)


@cache
def _watched() -> None:
    threading.Thread(target=_watch, name="standstill", daemon=True).start()


def _judged(item: pytest.Item) -> Generator[None, Any, Any]:
    if item.get_closest_marker("processes") is None:
        return (yield)
    _watched()
    before = sum(LATE_S)
    try:
        return (yield)
    except (Exception, pytest.fail.Exception) as error:
        if (stood_s := sum(LATE_S) - before) > 0:
            raise MachineStoodStill(f"for {stood_s:.1f} s while this test ran, which failed") from error
        raise


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


def _order(item: pytest.Item) -> tuple[int, int]:
    """Sorting key of the tests: the longer a group takes, the earlier it begins, so that no worker is left with it.

    Packages are installed first: that waits for disks and network while other workers compute. Tests that start
    processes come last, and the long ones first among them: groups, the soak, whole pages.
    """
    group = item.get_closest_marker("xdist_group")
    if group is not None and group.args[0] == "packaging":
        return 0, 0
    if item.get_closest_marker("processes") is None:
        return 1, len(item.path.parts)
    return (2 if group is not None else 3), len(item.path.parts)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=_order)
    for item in items:
        if item.get_closest_marker("processes") is not None:
            item.add_marker(AGAIN)
    if config.getoption("loadgroup", False):  # this is a worker, and `--dist loadgroup` was asked for
        for item in items:
            _join(item)


def _join(item: pytest.Item) -> None:
    """One worker runs all tests of a file, or, if they start processes, all tests of an `xdist_group`.

    The scheduler reads the group behind the @ of a name; pytest-xdist alone writes it where pytest 9.2 does not look.
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
