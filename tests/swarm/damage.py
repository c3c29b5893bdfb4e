"""Damage done to bytes on their way."""

from collections.abc import Sequence

from hypothesis import strategies as st


@st.composite
def damaged(draw: st.DrawFn, honest: Sequence[bytes]) -> bytes:
    """An honest message, hurt in up to four places: bytes changed, cut out, put in, cut off, spliced with another."""
    raw = bytearray(draw(st.sampled_from(honest)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, min(len(raw), 400)) | st.integers(0, len(raw)))
        how = draw(st.sampled_from(["change", "change", "change", "cut", "insert", "truncate", "splice"]))
        if how == "change" and at < len(raw):
            raw[at] = draw(st.integers(0, 255))
        elif how == "cut":
            del raw[at : at + draw(st.integers(1, 9))]
        elif how == "insert":
            raw[at:at] = draw(st.binary(min_size=1, max_size=9))
        elif how == "truncate":
            del raw[at:]
        elif how == "splice":
            other = draw(st.sampled_from(honest))
            raw[at:] = other[draw(st.integers(0, min(len(other), 400))) :]
    return bytes(raw)
