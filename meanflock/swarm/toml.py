"""TOML from users: own and shipped files, settings on a command line, and the base class of all tables."""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec

from meanflock.swarm import paths
from meanflock.swarm.errors import BadInput, meant
from meanflock.swarm.state import BEYOND_SENSE

FOLDER = Path("scenarios")  # of the names that users give to the shipped files, in every working folder
_SURROGATE = re.compile("[\ud800-\udfff]")  # stands for a byte that is not UTF-8
_SHIPPED = Path(__file__).parent / "scenarios"
_NESTED = (tuple, list, dict)  # as the options of a plug-in may be


Point: TypeAlias = Annotated[
    tuple[float, ...], msgspec.Meta(min_length=2, max_length=3)
]  # x, y, and in space perhaps z


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, repr_omit_defaults=True):
    """Base class of a scenario's tables. It rejects unknown keys, numbers whose squares are not finite, and texts that
    are not Unicode.
    """

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            whole = getattr(self, name)
            for value in _flat(whole) if isinstance(whole, _NESTED) else (whole,):
                if isinstance(value, float) and not abs(value) <= BEYOND_SENSE:  # false for NaN
                    raise ValueError(f"`{name}` must be a finite number within ±{BEYOND_SENSE:.0e}, not {value}")
                if isinstance(value, str) and _SURROGATE.search(value):
                    raise ValueError(f"`{name}` must be Unicode text, not {value!a}")
        if self.__struct_config__.omit_defaults:
            for field in msgspec.structs.fields(self):  # an encoder leaves out the default itself, and no equal number
                if isinstance(field.default, float) and getattr(self, field.name) == field.default:
                    msgspec.structs.force_setattr(self, field.name, field.default)


def _flat(value: Any) -> Iterator[Any]:
    if isinstance(value, _NESTED):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _flat(inner)
    else:
        yield value


def shipped() -> list[Path]:
    """Names of the scenarios and fault scripts that come with meanflock, as `scenarios/NAME.toml`."""
    return sorted(FOLDER / path.name for path in _SHIPPED.glob("*.toml"))


def found(path: Path) -> Path:
    """The path itself if the file exists; else that of the shipped file `scenarios/swap.toml` or `swap`, if any."""
    named = FOLDER / f"{path}.toml" if path.parent == Path() and not path.suffix else path
    return path if path.is_file() or named not in shipped() else _SHIPPED / named.name


def read(path: Path, kind: str) -> dict[str, Any]:
    """Read the table of a file or a pipe, or of a shipped file. `kind`: that of the file, for an error.

    Raises:
        BadInput: the file does not exist, cannot be read, or is not TOML.
    """
    path = paths.given(path)
    try:
        return parse(paths.read_stream(found(path)))
    except OSError as error:
        if (of_run := path / "scenario.toml").is_file():
            raise BadInput(f"{path}: the folder of a run; give its scenario, {of_run}") from error
        names = [file.stem for file in shipped()]
        named = path.parent == FOLDER or not path.suffix or path.stem in names
        choices = f", or name one of {', '.join(names)}{meant(path.stem, names)}" if named else ""
        raise BadInput(f"{path}: {error.strerror}; give a readable {kind}{choices}") from error
    except ValueError as error:  # from the parser, or from bytes that are not UTF-8
        raise BadInput(f"{path}: not TOML: {error}") from error


def parse(content: bytes) -> dict[str, Any]:
    """The table in a TOML file; raises ValueError if it is not TOML."""
    import tomllib  # only here: nodes are sent their scenario as JSON

    try:
        return tomllib.loads(content.decode("utf-8-sig"))  # some editors write a byte order mark
    except RecursionError:
        raise ValueError("lists or tables are nested too deeply") from None


def apply(table: dict[str, Any], setting: str) -> str:
    """Sets one dotted key of `table` from the text `a.b=c`, c in TOML syntax; a bare word is a string.

    Returns:
        The key.

    Raises:
        BadInput: the setting has another form, or its key leads through a value that is not a table.
    """
    key, equals, text = setting.partition("=")
    if not equals or not key.strip():
        raise BadInput(f"--set {setting}: write it as key=value, for example --set wind.sigma=0.2")
    try:
        value = parse(f"value = {text}".encode())["value"]
    except (ValueError, KeyError) as error:
        value = text.strip()
        if value[:1] in tuple("[{\"'"):  # not a bare word
            raise BadInput(f"--set {setting}: `{value}` is not TOML: {error}") from error
    key = key.strip()
    put(table, key, value, f"--set {setting}")
    return key


def inline(value: Any) -> str:
    """A value as TOML reads it on one line."""
    import json  # only here: nodes read no settings

    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {inline(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value)


def put(table: dict[str, Any], key: str, value: Any, where: str = "") -> None:
    """Sets one dotted key of `table`; a table of a list is found by its `name`, as in `groups.couriers.count`.

    Args:
        where: the place of the setting, for an error.

    Raises:
        BadInput: the key leads through a value that is not a table, or no table of a list has the name.
    """
    *parents, last = key.split(".")
    inner: Any = table
    for parent in parents:
        if isinstance(inner, dict):
            inner = inner.setdefault(parent, {})
        else:
            named = {one["name"]: one for one in inner if isinstance(one, dict) and "name" in one}
            if parent not in named:
                raise BadInput(
                    f"{where or key}: none is called {parent!r}{meant(parent, named)}; there are {', '.join(named)}"
                )
            inner = named[parent]
        has_names = isinstance(inner, list | tuple) and any(isinstance(one, dict) and "name" in one for one in inner)
        if not isinstance(inner, dict) and not has_names:
            raise BadInput(f"{where or key}: `{parent}` is not a table")
    if not isinstance(inner, dict):
        raise BadInput(f"{where or key}: `{parents[-1]}` are several tables; write {parents[-1]}.NAME.KEY")
    inner[last] = value
