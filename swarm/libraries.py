"""What is said where a library is missing. Imports nothing that could be missing itself."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_RUN_FAILED


@contextmanager
def needed(by: str, extra: str = "") -> Iterator[None]:
    """Libraries that are imported while the context lasts are needed `by` somebody, and come with `extra` of ours.

    Raises:
        SystemExit: one is not installed, and a line on stderr says which, and what to install; or Ctrl-C came, which
            nobody else listens for yet.
    """
    try:
        yield
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        raise SystemExit(EXIT_RUN_FAILED) from None
    except ModuleNotFoundError as missing:
        if not (what := lacking(missing, by, extra)):
            raise
        print(f"error: {what}", file=sys.stderr)
        raise SystemExit(EXIT_BAD_INPUT) from None


def lacking(error: BaseException, by: str, extra: str = "") -> str:
    """What to install where `error` says that a library which is needed `by` somebody is not there; else nothing."""
    library = ((isinstance(error, ModuleNotFoundError) and error.name) or "").partition(".")[0]
    if library in ("meanflock", "") or _is_there(library):
        return ""
    package = f"'meanflock[{extra}]'" if extra else "meanflock"
    return f"{library} is not installed, and {by} needs it: pip install {package}"


def _is_there(library: str) -> bool:
    """Whether it is a part of an installed library that is missing: a defect, and no matter of extras."""
    try:
        return find_spec(library) is not None
    except ValueError:
        return False
