"""Messages between the launcher and the process that forks the rooms, over a socket that keeps their bounds."""

import msgspec

MOST_BYTES = 2**17  # of a message


class StartOrder(msgspec.Struct, frozen=True, tag=True):
    """Order: fork a program.

    number: by which later messages name the process.
    command: the command that would start it alone.
    log: file for its standard error.
    """

    number: int
    module: str
    command: list[str]
    log: str


class Prepare(msgspec.Struct, frozen=True, tag=True):
    """Order: compute what every agent of a flight would compute at its start.

    scenario: its file. variables: of the environment of all forks.
    """

    scenario: str
    variables: dict[str, str]


class Signal(msgspec.Struct, frozen=True, tag=True):
    """Order: send a signal to a process."""

    number: int
    signal: int


class Loaded(msgspec.Struct, frozen=True, tag=True):
    """Report: everything is loaded. `may_fork`: false if a plug-in has started a thread."""

    may_fork: bool


class Ended(msgspec.Struct, frozen=True, tag=True):
    """Report: a process has ended, with this exit code or minus this signal."""

    number: int
    code: int


Order = StartOrder | Prepare | Signal
Report = Loaded | Ended
encode = msgspec.msgpack.Encoder().encode
orders = msgspec.msgpack.Decoder(Order)
reports = msgspec.msgpack.Decoder(Report)
