"""Signals while processes of a study start."""

import signal

import pytest

from meanflock.groundstation.backends import terminable, unbroken


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_must_not_be_broken_off_is_finished_first(number: signal.Signals) -> None:
    was = signal.signal(number, signal.default_int_handler)  # whoever runs the tests may ignore it
    finished = []

    def start() -> None:
        with terminable(), unbroken():
            signal.raise_signal(number)
            signal.raise_signal(number)
            finished.append(number)

    try:
        with pytest.raises(KeyboardInterrupt):
            start()
        assert finished == [number]
        assert signal.getsignal(number) == signal.default_int_handler
    finally:
        signal.signal(number, was)
