"""The paper's claims as typed records, read from `claims.toml`."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

Kind = Literal["order", "ratio", "equal", "bound", "share", "rate", "trend", "slope", "point", "best"]
Basis = Literal["measured", "arithmetic", "calibrated", "by construction", "no divergence"]
Direction = Literal["lower", "higher", "falling", "rising", "little gain"]

COMPARING = frozenset({"order", "ratio", "slope", "best"})  # kinds that need `against`
WITH_THRESHOLD = frozenset({"ratio", "equal", "bound", "share", "rate", "best"})


class Check(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One testable statement of a claim; `claims.toml` explains the kinds."""

    kind: Kind
    metric: str
    experiment: str = "s0"
    experiments: tuple[str, ...] = ()  # of a best case
    source: Literal["runs", "theory", "turn"] = "runs"
    subject: tuple[str, ...] = ()
    against: tuple[str, ...] = ()
    direction: Direction = "lower"
    event: Literal["some", "none"] = "some"
    threshold: float | None = None
    tolerance: Annotated[float, Meta(ge=0, description="relative, of an equality")] = 0.0
    at: float | None = None  # one point of the grid
    start: float | None = field(name="from", default=None)
    stop: float | None = field(name="to", default=None)
    above: float | None = None
    points: Literal["all", "most"] = "all"
    setting: str | None = None  # only runs with this setting
    trained: bool | None = None  # only runs that took off trained, or untrained

    def __post_init__(self) -> None:
        if self.kind in COMPARING and not self.against:
            raise ValueError(f"a check of kind {self.kind} needs `against`")
        if self.kind in WITH_THRESHOLD and self.threshold is None:
            raise ValueError(f"a check of kind {self.kind} needs `threshold`")
        if self.direction == "little gain" and self.threshold is None:
            raise ValueError("little gain needs `threshold`: how little")
        if self.source != "theory" and not self.subject:
            raise ValueError("`subject` names no method")


class Claim(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A claim: its statement, metric and scenario, and the checks that decide it.

    kind: what a verdict on it rests on. measured: flights. arithmetic: message sizes and periods alone. calibrated: a
    parameter was chosen with it in view. by construction: it follows from how it is asked. no divergence: the checks
    fail only if a learner or a state diverges.
    """

    id: Annotated[str, Meta(pattern="^[CO][1-9][0-9]?$")]  # O: our own, about what the paper does not say
    kind: Basis = "measured"
    figure: str
    statement: str
    metric: str
    scenario: str
    note: str = ""
    untestable: str = ""  # why no data can decide it
    check: tuple[Check, ...] = ()

    def __post_init__(self) -> None:
        if not self.check and not self.untestable:
            raise ValueError(f"{self.id} has no check and does not say why")


def load() -> list[Claim]:
    """The claims in the order of the paper."""
    return [claim for claim in _all() if claim.id.startswith("C")]


def own() -> list[Claim]:
    """Our own claims, which explain why the paper's hold or fail."""
    return [claim for claim in _all() if claim.id.startswith("O")]


def _all() -> list[Claim]:
    text = Path(__file__).with_name("claims.toml").read_bytes()
    return msgspec.toml.decode(text, type=dict[str, list[Claim]])["claim"]
