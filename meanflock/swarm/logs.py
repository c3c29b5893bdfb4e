"""The log of a process on standard error: text for people, or one JSON object a line for machines."""

import logging
import os
import sys
from datetime import UTC, datetime
from typing import Any

from meanflock.swarm.errors import BadInput, printable, printable_lines

TEXT, JSON = "text", "json"
FIELDS = ("tick", "peer", "uavs", "reason")  # optional fields of a line, from `extra=` of the logging call
_NAME = "meanflock"
_LEVELS = ("DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL")


class TextLines(logging.Formatter):
    """Formatter of text: time, logger, level and message on one line, then a traceback, if any."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(name)s %(levelname)s %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Returns the line."""
        record.message = printable(record.message, len(record.message))
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:
        """Returns the traceback, indented so that its lines differ from lines of the log."""
        return "\n".join(f"    {line}" for line in printable_lines(super().formatException(ei)).split("\n"))


class JsonLines(logging.Formatter):
    """Formatter of JSON: time, level, logger and message, then fields of the process, then fields of the record."""

    def __init__(self, fields: dict[str, Any]) -> None:
        """`fields`: fields of every line, such as run and node; read anew for each line."""
        super().__init__()
        self._fields = fields

    def format(self, record: logging.LogRecord) -> str:
        """Returns one line."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **self._fields,
            **{name: record.__dict__[name] for name in FIELDS if name in record.__dict__},
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        import json  # only here: most logs are text

        return json.dumps(line, default=str)


def check(form: str) -> str:
    """Check the name of a form, and return it.

    Raises:
        BadInput: there is no such form.
    """
    if form not in (TEXT, JSON):
        raise BadInput(f"--log-format {form}: choose {TEXT} or {JSON}")
    return form


def start(form: str, **fields: Any) -> dict[str, Any]:
    """Start the log on standard error, in a form, from the level $MEANFLOCK_LOG (default WARNING) on.

    Returns:
        The fields of every line, to which the caller may add.

    Raises:
        BadInput: there is no such form or level.
    """
    level = os.environ.get("MEANFLOCK_LOG", "WARNING").upper()
    if level not in _LEVELS:
        raise BadInput(f"MEANFLOCK_LOG={level}: choose one of {', '.join(_LEVELS)}")
    handler = logging.StreamHandler(sys.stderr)
    handler.set_name(_NAME)
    handler.setFormatter(JsonLines(fields) if check(form) == JSON else TextLines())
    stop()
    logging.root.addHandler(handler)
    logging.root.setLevel(level)
    return fields


def stop() -> None:
    """Stop the log that `start` began."""
    for handler in _ours():
        logging.root.removeHandler(handler)
        logging.root.setLevel(logging.WARNING)


def show(text: str, level: int = logging.INFO) -> None:
    """Print a text at every level of the log; as a line of the log if that is JSON."""
    for handler in _ours():
        if isinstance(handler.formatter, JsonLines):
            handler.handle(logging.LogRecord("meanflock", level, __file__, 0, text, None, None))
            return
    print(printable_lines(text), file=sys.stderr, flush=True)


def note(text: str, level: int) -> None:
    """Print a text as `show` does, a warning after that word."""
    show(f"warning: {text}" if level == logging.WARNING else text, level)


def divert() -> None:
    """Redirect the output of native code to standard error. Only `sys.stdout` still writes to standard output.

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
