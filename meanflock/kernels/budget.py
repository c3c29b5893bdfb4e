"""Link budget: sums of waves over the plane, and numbers between the columns of tables."""

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Floats

# cos(2π√s) for s of 0 to ¼ as a polynomial, by Chebyshev's interpolation; the error is below 1e-12.
COSINE = (
    0.9999999999990572,
    -19.73920880156809,
    64.93939395749398,
    -85.45681452618881,
    60.2445860904632,
    -26.425615415608224,
    7.89915473617536,
    -1.6968620513109494,
    0.2437498023858064,
)


def waves(place: Floats, vectors: Floats, phase: Floats, sums: Floats) -> None:
    """Write Σ_m cos(2π (k_m · x + φ_m)) of each place x to `sums`.

    Args:
        place: (N, 2). vectors: (2, M), k in turns. phase: (M,), φ in turns. sums: (N,).
    """
    turns = place[:, :1] * vectors[0] + place[:, 1:] * vectors[1] + phase
    turns -= np.rint(turns)
    turns *= turns
    cosine = np.full_like(turns, COSINE[-1])
    for coefficient in COSINE[-2::-1]:
        cosine *= turns
        cosine += coefficient
    np.add.reduce(cosine, axis=-1, out=sums)


def interpolate(tables: Floats, row: NDArray[np.intp], place: Floats, found: Floats) -> None:
    """Write the numbers of tables, each with R rows and C ≥ 2 columns, between the two columns around each place.

    Args:
        tables: (T, R, C). row: (K,), of each link. place: (K,), its column; one beyond the ends counts as the end.
            found: (T, K), written.
    """
    columns = tables.shape[2]
    if columns < 2 or (len(row) and not 0 <= row.min() <= row.max() < tables.shape[1]):
        raise ValueError("interpolate: a row that no table has, or tables of one column")
    inside = np.fmin(np.fmax(place, 0.0), columns - 1.0)
    index = np.minimum(inside.astype(np.intp), columns - 2)
    part = inside - index
    index += row * columns
    flat = tables.reshape(len(tables), -1)
    before = flat.take(index, axis=1)
    found[...] = before + part * (flat.take(index + 1, axis=1) - before)
