"""`summary.json` as a typed record, whose fields are those of the registry of quantities."""

from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, TypeAlias

import msgspec
from msgspec import Meta

from meanflock.results.quantities import SUMMARY as FIELDS
from meanflock.swarm import paths
from meanflock.swarm.errors import BadInput
from meanflock.worldsim.summary import SCHEMA

_MEND = "bring the file back, or fly the run again"
_Number: TypeAlias = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)] | float | None  # JSON has finite numbers only
_Value: TypeAlias = bool | str | _Number | list[list[float]]  # without a unit: a hash, a name, the list of links


class _Version(msgspec.Struct):
    """The version of a record, and of the meanflock that wrote it."""

    schema: Any = None
    version: Any = None


def _struct(prefix: str) -> type[msgspec.Struct]:
    """The type of the table whose dotted keys begin with `prefix`."""
    inner = [field.key.removeprefix(prefix) for field in FIELDS if field.key.startswith(prefix)]
    names = dict.fromkeys(key.partition(".")[0] for key in inner)
    fields: list[Any] = [
        (name, _type(prefix + name) | msgspec.UnsetType, msgspec.UNSET)
        if _is_optional(prefix + name)
        else (name, _type(prefix + name))
        for name in names
    ]
    return msgspec.defstruct(f"Summary_{prefix}", fields, kw_only=True)


def _is_optional(key: str) -> bool:
    """Returns whether records of older versions may lack the field or table of a dotted key."""
    return all(field.optional for field in FIELDS if field.key == key or field.key.startswith(f"{key}."))


def _type(key: str) -> Any:
    """The type of a field by its dotted key. A table that is a field itself may be null."""
    field = next((field for field in FIELDS if field.key == key), None)
    if any(other.key.startswith(f"{key}.*.") for other in FIELDS):
        tables = GenericAlias(dict, (str, _struct(f"{key}.*.")))
        return tables | None if field is not None else tables
    if (any_name := next((field for field in FIELDS if field.key == f"{key}.*"), None)) is not None:
        return GenericAlias(dict, (str, _Number if any_name.unit else _Value))
    if any(other.key.startswith(f"{key}.") for other in FIELDS):
        return _struct(f"{key}.") | None if field is not None else _struct(f"{key}.")
    assert field is not None
    return _Number if field.unit else _Value


Summary = _struct("")


def read_summary(path: Path) -> dict[str, Any]:
    """The fields of a summary, each of its type. Records of older versions lack the optional fields.

    Raises:
        BadInput: it is missing, damaged or of another version.
    """
    try:
        content = paths.read(path)
        found = msgspec.json.decode(content, type=_Version)
        if found.schema != SCHEMA:
            raise BadInput(
                f"{path.name}: a record of version {found.schema!r}, written by meanflock {found.version}; this "
                f"meanflock reads version {SCHEMA}: use the meanflock that wrote it"
            )
        fields: dict[str, Any] = msgspec.to_builtins(msgspec.json.decode(content, type=Summary))
        return fields
    except OSError as error:
        raise BadInput(f"{path.name}: {error.strerror}; {_MEND}") from error
    except msgspec.ValidationError as error:
        raise BadInput(f"{path.name}: damaged, or of another meanflock: {error}; {_MEND}") from error
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise BadInput(f"{path.name}: damaged: not JSON; {_MEND}") from error
