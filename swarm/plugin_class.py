"""What a class must have to be a plug-in."""

import re
from typing import Any, Literal, TypeAlias

import msgspec

from meanflock.swarm.errors import BadInput

Door: TypeAlias = Literal["controller", "aggregator", "channel", "vehicle", "filter", "topology"]

NEEDED: dict[Door, tuple[str, ...]] = {  # what a class must have; the rest has defaults in the base classes
    "controller": ("init", "step"),
    "aggregator": ("step",),
    "channel": ("transmit",),
    "vehicle": ("step", "power"),
    "filter": ("init", "step"),
    "topology": ("hops",),
}
PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")  # names: they are parts of those of files and of keys


def checked(door: Door, name: str, found: Any, source: str) -> type:
    """`found` itself, of a package or file `source`.

    Raises:
        BadInput: it is no class that can be had at that door, under that name.
    """
    if not isinstance(found, type):
        raise BadInput(f"{door} {name!r} of {source} is a {type(found).__name__}; it must be a class")
    if not PLAIN.fullmatch(name):
        raise BadInput(f"{door} {name!r} of {source}: a name is up to 64 of A-Z, a-z, 0-9, '-', '_' and '.'")
    lacking = [method for method in NEEDED[door] if not callable(getattr(found, method, None))]
    lacking += [method for method in dir(found) if getattr(getattr(found, method, None), "__isabstractmethod__", False)]
    if lacking:
        raise BadInput(f"{door} {name!r} of {source} lacks {' and '.join(f'`{method}`' for method in lacking)}")
    options = getattr(found, "Options", None)
    if not (isinstance(options, type) and issubclass(options, msgspec.Struct)):
        raise BadInput(f"{door} {name!r} of {source}: `Options` must be a msgspec.Struct")
    return found
