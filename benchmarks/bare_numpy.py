"""The floor of a learner's tick: the array operations a NumPy learner cannot do without, on buffers made beforehand.

Shapes are those of σ_H (54 features), σ_F (69) and the quadrature (495 products, 64 nodes); the numbers mean nothing.
With one row the arithmetic is negligible; the cost is that of the NumPy calls.
"""

from collections.abc import Callable

import numpy as np

from meanflock.kernels.mean_field.layout import DENSITY_FEATURES, VALUE_FEATURES

_PRODUCTS = 495
_NODES = 64
_POWERS = 28


def learner_operations(rows: int) -> Callable[[], None]:
    """A call that does one tick of `rows` learners' array operations and nothing else."""
    draw = np.random.default_rng(1)
    states = draw.random((rows, 4))
    weights_h, gradient_h = draw.random((rows, 2 * VALUE_FEATURES)), np.zeros((rows, 2 * VALUE_FEATURES))
    weights_f, gradient_f = draw.random((rows, 2 * DENSITY_FEATURES)), np.zeros((rows, 2 * DENSITY_FEATURES))
    powers = np.zeros((rows, 4, 7))
    features, other_h = np.zeros((rows, 216)), np.zeros((rows, 216))
    pairs, other_p = np.zeros((rows, 120)), np.zeros((rows, 120))
    terms, other_t = np.zeros((rows, 70)), np.zeros((rows, 70))
    products, other_q = np.zeros((rows, _PRODUCTS)), np.zeros((rows, _PRODUCTS))
    operator, other_o = np.zeros((rows, 2 * DENSITY_FEATURES)), np.zeros((rows, 2 * DENSITY_FEATURES))
    expansion = np.zeros((rows, 1, 70))
    mass = np.zeros((rows, 1, _NODES))
    sums = np.zeros((rows, 1, 2))
    monomials, one_and_kernel = draw.random((70, _NODES)), draw.random((_NODES, 2))
    factor_h = draw.random(216)
    factor_p = draw.random(120)
    factor_q = draw.random(_PRODUCTS)
    action = np.zeros((rows, 2))
    number = np.zeros(rows)
    step = np.zeros((rows, 1))
    starts = np.arange(70) * 7
    left, right = draw.random((rows, 1, 3)), draw.random((rows, 1, 4))
    image_r, image_v = np.zeros((rows, 1, 15)), np.zeros((rows, 1, 15))
    pick = {size: draw.integers(0, _POWERS, size) for size in (216, 120, 70, 138)}
    pick_w, pick_t = draw.integers(0, DENSITY_FEATURES, _PRODUCTS), draw.integers(0, 70, _PRODUCTS)
    flat = powers.reshape(rows, _POWERS)
    per_axis = features.reshape(rows, 4, 2, 27)
    value, slope = weights_h.reshape(rows, 2, 2, 27)[:, 0], gradient_h.reshape(rows, 2, 2, 27)[:, 0]
    extra = np.zeros((rows, 2, 27))
    by_pairs = pairs.reshape(rows, 8, 15)

    def gather(source: np.ndarray, first: np.ndarray, second: np.ndarray, out: np.ndarray, other: np.ndarray) -> None:
        source.take(first, axis=-1, out=out, mode="clip")
        source.take(second, axis=-1, out=other, mode="clip")
        np.multiply(out, other, out=out)

    def tick() -> None:
        # Features of both networks.
        powers[...] = states[:, :, None]
        np.multiply.accumulate(powers, axis=-1, out=powers)
        gather(flat, pick[216], pick[216], features, other_h)
        np.multiply(features, factor_h, out=features)
        gather(flat, pick[120], pick[120], pairs, other_p)
        np.multiply(pairs, factor_p, out=pairs)
        gather(pairs, pick[70], pick[70], terms, other_t)
        # φ_G by quadrature.
        weights_f.take(pick_w, axis=-1, out=products, mode="clip")
        terms.take(pick_t, axis=-1, out=other_q, mode="clip")
        np.multiply(products, other_q, out=products)
        np.multiply(products, factor_q, out=products)
        np.add.reduceat(products, starts, axis=-1, out=expansion[:, 0])
        np.matmul(expansion, monomials, out=mass)
        np.maximum(mass, 0.0, out=mass)
        np.matmul(mass, one_and_kernel, out=sums)
        # Value step and action.
        np.vecdot(per_axis[:, 2], value, out=action)
        np.multiply(per_axis[:, 3], 0.5, out=slope)
        np.multiply(per_axis[:, 1], action[..., None], out=extra)
        np.add(slope, extra, out=slope)
        np.multiply(per_axis[:, 2], action[..., None], out=extra)
        np.add(slope, extra, out=slope)
        np.vecdot(weights_h, gradient_h, out=number)
        np.multiply(number, 1e-9, out=step[:, 0])
        np.subtract(weights_h, step, out=weights_h)
        np.vecdot(per_axis[:, 2], value, out=action)
        np.vecdot(per_axis[:, 3], value, out=action)
        # Density step.
        np.matmul(left, by_pairs[:, 0:3], out=image_r)
        np.matmul(right, by_pairs[:, 4:8], out=image_v)
        gather(pairs, pick[138], pick[138], operator, other_o)
        np.add(operator[:, :DENSITY_FEATURES], operator[:, DENSITY_FEATURES:], out=gradient_f[:, :DENSITY_FEATURES])
        np.vecdot(weights_f, gradient_f, out=number)
        np.multiply(number, 1e-9, out=step[:, 0])
        np.subtract(weights_f, step, out=weights_f)

    return tick
