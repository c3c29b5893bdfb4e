"""All Zenoh key expressions. A node publishes under its own name only, so access control can restrict it to that."""

import re
import zlib
from functools import lru_cache

from meanflock.swarm.errors import BadInput, MessageRejected

ROOT = "meanflock"
_RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_NAME = _RUN_NAME.pattern  # roles and nodes as well
_KEY_OF_A_NODE = re.compile(rf"{ROOT}/{_NAME}/(?:node/({_NAME})/(?:join|act|sense)|alive/{_NAME}/({_NAME}))")
_KEY_OF_A_TOKEN = re.compile(rf"{ROOT}/{_NAME}/alive/({_NAME})/({_NAME})")


def check_run(run: str) -> str:
    """Check that a run's name can be part of a key, and return it.

    Raises:
        BadInput: it cannot.
    """
    if not _RUN_NAME.fullmatch(run):
        raise BadInput(f"run name {run!r}: use up to 64 letters, digits, '.', '_' or '-'")
    return run


def fingerprint(run: str) -> int:
    """The 32-bit number of a run in its messages."""
    return zlib.crc32(run.encode())


def requested_name(role: str, uav: int = -1) -> str:
    """The name under which a node asks to join: its own, or its role if the world may choose its UAVs."""
    return f"{role}-{uav}" if uav >= 0 else role


def join(run: str, name: str = "*") -> str:
    """Key of questions to join; `name` is that of `requested_name`."""
    return f"{ROOT}/{run}/node/{name}/join"


@lru_cache(maxsize=4096)  # called in every tick
def sense(run: str, node: str) -> str:
    """Key of requests: world → node."""
    return f"{ROOT}/{run}/node/{node}/sense"


@lru_cache(maxsize=4096)  # called in every tick
def act(run: str, node: str) -> str:
    """Key of replies: node → world; `*` for all nodes."""
    return f"{ROOT}/{run}/node/{node}/act"


def telemetry(run: str) -> str:
    """Key of telemetry: world → listeners."""
    return f"{ROOT}/{run}/telemetry"


def observed(run: str) -> str:
    """Key of the telemetry that need not be acknowledged: world → observers."""
    return f"{ROOT}/{run}/observed"


def received(run: str) -> str:
    """Key of acknowledgements: recording listener → world."""
    return f"{ROOT}/{run}/received"


def alive(run: str, role: str, node: str) -> str:
    """Key of the liveliness token of a node; `*` for all."""
    return f"{ROOT}/{run}/alive/{role}/{node}"


@lru_cache(maxsize=4096)  # called in every tick; a wrong key is not cached
def node_of(key: str) -> str:
    """Name of the node in a key of `join`, `act`, `sense` or `alive`.

    Raises:
        MessageRejected: `wrong-key`: another key. A sender can choose any key, wildcards included.
    """
    if (match := _KEY_OF_A_NODE.fullmatch(key)) is None:
        raise MessageRejected("wrong-key", key)
    return match[1] or match[2]


def presence_of(key: str) -> tuple[str, str]:
    """Role and name in the key of a liveliness token.

    Raises:
        MessageRejected: `wrong-key`: it is not a key of a token.
    """
    if (match := _KEY_OF_A_TOKEN.fullmatch(key)) is None:
        raise MessageRejected("wrong-key", key)
    return match[1], match[2]
