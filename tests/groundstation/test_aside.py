"""The background worker does its work in order, all of it, and reports its errors to the caller."""

import threading

import pytest

from meanflock.groundstation.results.run_folder import BackgroundWorker


def test_work_is_done_in_order_and_the_next_waits_for_the_one_before() -> None:
    aside, go, begun = BackgroundWorker("test"), threading.Event(), threading.Event()
    done: list[object] = []
    aside.do(go.wait)
    second = threading.Thread(target=lambda: (aside.do(lambda: done.append(0)), begun.set()))
    second.start()
    assert not begun.wait(0.05)
    go.set()
    assert begun.wait(10.0)
    second.join()
    for number in range(1, 20):
        aside.do(lambda number=number: done.append(number))
    aside.do(lambda: done.append(threading.current_thread()))
    aside.close()
    assert done[:-1] == list(range(20))
    assert done[-1] is not threading.current_thread()


@pytest.mark.parametrize("call", ["do", "wait", "close", "look"])
def test_the_next_call_raises_the_error_of_the_work_once(call: str) -> None:
    aside, go = BackgroundWorker("test"), threading.Event()

    def fail() -> None:
        go.wait()
        raise OSError(28, "No space left on device")

    aside.do(fail)
    aside.look()  # does not wait
    go.set()
    assert aside._doing is not None
    aside._doing.exception(10.0)
    with pytest.raises(OSError, match="No space"):
        getattr(aside, call)(*[lambda: None] * (call == "do"))
    aside.look()
    aside.close()
