"""The condition of the key `until`."""

import math
import re
from typing import NamedTuple

_FORM = re.compile(r"\s*([A-Za-z_]\w*)\s*(>=|<=|=)\s*(\S+)\s*")


class Until(NamedTuple):
    """A bound that a metric reaches, from above if `is_upper`, else from below."""

    metric: str
    value: float
    is_upper: bool

    @classmethod
    def of_text(cls, text: str) -> "Until":
        """The condition in a text.

        Raises:
            ValueError: it has another form; the text says which.
        """
        found = _FORM.fullmatch(text)
        try:
            if found is None or not math.isfinite(value := float(found[3])):
                raise ValueError
            return cls(found[1], value, found[2] == "<=")
        except ValueError:
            raise ValueError(
                f"`until` is {text!r}; expected a metric and a bound, as in accuracy=0.9 (at least) or loss<=0.3"
            ) from None

    def __str__(self) -> str:
        """The condition in symbols: `accuracy ≥ 0.9`."""
        return f"{self.metric} {'≤' if self.is_upper else '≥'} {self.value:.6g}"

    def is_met(self, value: float) -> bool:
        """Returns whether a value reaches the bound."""
        return value <= self.value if self.is_upper else value >= self.value
