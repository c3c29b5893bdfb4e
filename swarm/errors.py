"""The exception tree, and the exit code each branch ends a process with."""

from meanflock.swarm.printable import printable

EXIT_DONE = 0
EXIT_RUN_FAILED = 1
EXIT_BAD_INPUT = 2


class MeanflockError(Exception):
    """Base class of the errors that meanflock raises. `exit_code` is the exit code of the process."""

    exit_code = EXIT_RUN_FAILED


class BadInput(MeanflockError):
    """A file, flag or variable that cannot be used; the message says what, where and how to mend it."""

    exit_code = EXIT_BAD_INPUT


class RunFailed(MeanflockError):
    """A run that began and could not be finished."""


class BusError(RunFailed):
    """The bus could not be opened, or the swarm could not be joined."""


class WorldGone(BusError):
    """The session with the world ended without a word: the world is gone, or the way to it."""


class Refused(BusError):
    """The world answered that a node cannot take part; `over`: because the flight is over."""

    def __init__(self, text: str, over: bool = False) -> None:
        super().__init__(text)
        self.over = over


class MessageRejected(MeanflockError):
    """Bytes from the network that are not a message of this run; `reason` is the name it is counted under.

    Reasons: `malformed`, `oversized`, `wrong-kind`, `wrong-shape`, `non-finite`, `wrong-run`, `stale`,
    `duplicate`, `unknown-node`, `wrong-name`, `wrong-round`, `wrong-key`. The detail may quote what came: it is shown
    as printable text.
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {printable(detail)}")
        self.reason = reason
