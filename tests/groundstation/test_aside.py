"""Work beside the thread that flies is done in order, all of it, and what goes wrong is told to whoever brought it."""

import threading

import pytest

from meanflock.groundstation.results.run_folder import BackgroundWorker


def test_work_is_done_in_order_in_another_thread_and_none_is_left() -> None:
    aside, done = BackgroundWorker("test"), []
    for number in range(20):
        aside.do(lambda number=number: done.append((number, threading.current_thread())))
    aside.close()
    assert [number for number, _ in done] == list(range(20))
    assert {thread for _, thread in done}.isdisjoint({threading.main_thread()})


def test_the_next_work_waits_for_the_one_before() -> None:
    aside, go, begun = BackgroundWorker("test"), threading.Event(), threading.Event()
    aside.do(go.wait)
    second = threading.Thread(target=lambda: (aside.do(lambda: None), begun.set()))
    second.start()
    assert not begun.wait(0.05)
    go.set()
    assert begun.wait(10.0)
    second.join()
    aside.close()


def fail() -> None:
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("asked", ["do", "wait", "close"])
def test_what_it_raised_is_raised_once_by_whatever_is_asked_next(asked: str) -> None:
    aside = BackgroundWorker("test")
    aside.look()
    aside.do(fail)
    with pytest.raises(OSError, match="No space"):
        getattr(aside, asked)(*[lambda: None] * (asked == "do"))
    aside.look()
    aside.close()


def test_a_look_does_not_wait() -> None:
    aside, go = BackgroundWorker("test"), threading.Event()

    def waits_and_fails() -> None:
        go.wait()
        fail()

    aside.do(waits_and_fails)
    aside.look()
    go.set()
    assert aside._doing is not None
    aside._doing.exception(10.0)
    with pytest.raises(OSError, match="No space"):
        aside.look()
    aside.close()
