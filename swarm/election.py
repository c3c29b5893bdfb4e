"""Who leads: a rule all agreed on beforehand, so that nobody has to negotiate when the leader is gone."""

from collections.abc import Iterable


def elect(living: Iterable[str], incumbent: str | None = None) -> str | None:
    """The incumbent while it lives, then the lowest name among the living; None where nobody lives.

    `living`: names of the leader nodes whose liveliness token stands. The answer depends on the set only.
    """
    names = set(living)
    return incumbent if incumbent in names else min(names, default=None)
