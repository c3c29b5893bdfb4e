"""The next call of the background worker raises the error of its work, once. Its order: test_durable.py."""

import threading

import pytest

from meanflock.groundstation.results.run_folder import BackgroundWorker


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
