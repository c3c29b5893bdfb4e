"""Exceptions of plug-ins, told in one line with the place in the plug-in where they were raised."""

import sys
import traceback
from pathlib import Path

PLUGIN_MODULE = "meanflock_plugin_"  # begins the name of the module that the file of a plug-in becomes
FAILURES = (Exception, SystemExit)  # a plug-in may raise these; Ctrl-C is the user's
_OURS = {"meanflock", "numpy", "click", *sys.stdlib_module_names}  # frames ignored when locating an error


def last_line(error: BaseException) -> str:
    """The error, and the line of the plug-in that raised it or that called what raised it."""
    if isinstance(error, SyntaxError) and error.filename:  # raised by who reads the file
        return f"{reason(error)} ({Path(error.filename).name}, line {error.lineno})"
    places = [  # top-level module, file and line, the innermost last
        (str(frame.f_globals.get("__name__")).partition(".")[0], frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
    ]
    theirs = [place for place in places if place[0] not in _OURS]
    own = [place for place in theirs if place[0] == theirs[0][0]]  # and not of what it calls
    if not own:
        return reason(error)
    _, file, line = own[-1]
    return f"{reason(error)} ({Path(file).name}, line {line})"


def reason(error: BaseException) -> str:
    """The error in one line, without its notes."""
    said = traceback.TracebackException(type(error), error, None)
    said.__notes__ = []  # they would be what is said last
    *_, last = said.format_exception_only()
    if type(error).__module__.startswith(PLUGIN_MODULE):  # a name that we gave the file
        last = last.removeprefix(f"{type(error).__module__}.")
    return " ".join(filter(None, map(str.strip, last.splitlines())))
