"""The log of a process on standard error: text for people, or one JSON object a line for machines."""

import logging
import os
import sys
from datetime import UTC, datetime
from typing import Any

from meanflock.swarm.errors import BadInput, printable, printable_lines

TEXT, JSON = "text", "json"
FIELDS = ("tick", "peer", "uavs", "reason")  # what a line may also know: `extra=` of the call that logs it
_NAME = "meanflock"
_LEVELS = ("DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL")


class TextLines(logging.Formatter):
    """time, logger, level and message of a record on one line, whatever is in the message; a traceback follows it."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(name)s %(levelname)s %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:
        """The line."""
        record.message = printable(record.message, len(record.message))
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:
        """The lines after it, indented: none looks like one of the log's own."""
        return "\n".join(f"    {line}" for line in printable_lines(super().formatException(ei)).split("\n"))


class JsonLines(logging.Formatter):
    """time, level, logger and message of a record, then what is known of its process, then what it knows itself."""

    def __init__(self, known: dict[str, Any]) -> None:
        """`known`: fields of every line, run and node for example; read anew for each."""
        super().__init__()
        self._known = known

    def format(self, record: logging.LogRecord) -> str:
        """One line, whatever is in the message."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **self._known,
            **{name: record.__dict__[name] for name in FIELDS if name in record.__dict__},
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        import json  # only here: most logs are text

        return json.dumps(line, default=str)


def check(form: str) -> str:
    """`form` itself, if it is one.

    Raises:
        BadInput: it is not.
    """
    if form not in (TEXT, JSON):
        raise BadInput(f"--log-format {form}: choose {TEXT} or {JSON}")
    return form


def start(form: str, **known: Any) -> dict[str, Any]:
    """From now on the log goes to standard error, in that form, from the level $MEANFLOCK_LOG on (WARNING).

    Returns:
        The fields of every line, which the caller may add to when it knows more.

    Raises:
        BadInput: there is no such form or level.
    """
    level = os.environ.get("MEANFLOCK_LOG", "WARNING").upper()
    if level not in _LEVELS:
        raise BadInput(f"MEANFLOCK_LOG={level}: choose one of {', '.join(_LEVELS)}")
    handler = logging.StreamHandler(sys.stderr)
    handler.set_name(_NAME)
    handler.setFormatter(JsonLines(known) if check(form) == JSON else TextLines())
    stop()
    logging.root.addHandler(handler)
    logging.root.setLevel(level)
    return known


def stop() -> None:
    """Takes the log of `start` down again."""
    for handler in _ours():
        logging.root.removeHandler(handler)
        logging.root.setLevel(logging.WARNING)


def tell(text: str, level: int = logging.INFO) -> None:
    """Says something whatever the level of the log: as it is, or as a line of it where that is JSON."""
    for handler in _ours():
        if isinstance(handler.formatter, JsonLines):
            handler.handle(logging.LogRecord("meanflock", level, __file__, 0, text, None, None))
            return
    print(printable_lines(text), file=sys.stderr, flush=True)


def divert() -> None:
    """From now on what native code prints goes to standard error; `sys.stdout` alone still reaches standard output.

    Zenoh and Rerun write their logs to standard output.
    """
    if sys.stdout is None:  # the parent process has closed it
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  # for as long as the process lives
        if sys.stdout.fileno() != 1:  # another file has its number by now
            return
    sys.stdout.flush()
    sys.stdout = os.fdopen(os.dup(1), "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)
    os.dup2(2, 1)


def _ours() -> list[logging.Handler]:
    return [handler for handler in logging.root.handlers if handler.name == _NAME]
