"""What a plug-in, which may be anybody's, can raise, and how it is told: in a line, with the place it went wrong in."""

import sys
import traceback
from pathlib import Path

PLUGIN_MODULE = "meanflock_plugin_"  # begins the name of the module that the file of a plug-in becomes
FAILURES = (Exception, SystemExit)  # what ends a script would else end a flight; Ctrl-C is the person's
_OURS = {"meanflock", "numpy", "click", *sys.stdlib_module_names}  # and what ours call, or are called by


def last_line(error: BaseException) -> str:
    """What went wrong, and the line of the plug-in in which it did, or in which that was called."""
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


def beside(path: Path, error: BaseException) -> str:
    """What to do where the file of a plug-in wants another of its folder, in which nobody looks for modules."""
    if isinstance(error, ImportError) and "relative import" in str(error):
        return "; a plug-in is one file, or a package: install the one it is of, for example with `pip install -e`"
    wanted = ((isinstance(error, ModuleNotFoundError) and error.name) or "").partition(".")[0]
    if not wanted or not ((path.parent / wanted).is_dir() or (path.parent / f"{wanted}.py").exists()):
        return ""
    return f"; a plug-in is one file, or a package: install what {wanted!r} is of, for example with `pip install -e`"


def reason(error: BaseException) -> str:
    """What went wrong, in a line, without the notes that were added to it."""
    said = traceback.TracebackException(type(error), error, None)
    said.__notes__ = []  # they would be what is said last
    *_, last = said.format_exception_only()
    if type(error).__module__.startswith(PLUGIN_MODULE):  # a name that we gave the file
        last = last.removeprefix(f"{type(error).__module__}.")
    return " ".join(filter(None, map(str.strip, last.splitlines())))
