"""TOML as a person gives it: files, and settings on a command line."""

from pathlib import Path
from typing import Any

from meanflock.swarm.errors import BadInput


def read(path: Path, what: str) -> dict[str, Any]:
    """A file, or one of those that come with meanflock; `what` it should be, for who is told that it is not.

    Raises:
        BadInput: it is not there, cannot be read, or is no TOML.
    """
    from meanflock.swarm import scenarios  # only here: nodes are sent their scenario as JSON

    try:
        return _parse(scenarios.found(path).read_text(encoding="utf-8-sig"))  # some editors begin a file with a mark
    except OSError as error:
        named = path.parent == scenarios.FOLDER or not path.suffix
        there = f", or name one of {', '.join(file.stem for file in scenarios.shipped())}" if named else ""
        raise BadInput(f"{path}: {error.strerror}; give a readable {what}{there}") from error
    except ValueError as error:  # of the parser, or bytes that are no UTF-8
        raise BadInput(f"{path}: not TOML: {error}") from error


def _parse(text: str) -> dict[str, Any]:
    """TOML, or ValueError."""
    import tomllib  # only here: nodes are sent their scenario as JSON

    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("lists or tables within each other, too deep to be read") from None


def apply(table: dict[str, Any], setting: str) -> str:
    """Sets one dotted key of `table` from the text `a.b=c`, c in TOML syntax; a bare word is a string.

    Returns:
        The key.

    Raises:
        BadInput: it is not written like that, or goes through something that is no table.
    """
    key, equals, text = setting.partition("=")
    if not equals or not key.strip():
        raise BadInput(f"--set {setting}: write it as key=value, for example --set wind.sigma=0.2")
    try:
        value = _parse(f"value = {text}")["value"]
    except (ValueError, KeyError) as error:
        value = text.strip()
        if value[:1] in tuple("[{\"'"):  # no bare word
            raise BadInput(f"--set {setting}: `{value}` is not TOML: {error}") from error
    key = key.strip()
    put(table, key, value, f"--set {setting}")
    return key


def put(table: dict[str, Any], key: str, value: Any, where: str = "") -> None:
    """Sets one dotted key of `table`; `where` it was asked for.

    Raises:
        BadInput: it goes through something that is no table.
    """
    *parents, last = key.split(".")
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise BadInput(f"{where or key}: `{parent}` is not a table")
    table[last] = value
