"""The colours of recordings can be told apart with every common colour vision."""

from itertools import combinations

import numpy as np
import pytest

from meanflock.recording import blueprint, drawing

# Linear RGB as it is seen: Machado, Oliveira and Fernandes, IEEE TVCG 15 (2009), severity 1.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE_POINT = np.array([0.95047, 1.0, 1.08883])


def lab(color: int, vision: np.ndarray) -> np.ndarray:
    """CIE 1976 L*a*b* of 0xRRGGBBAA as somebody sees it."""
    part = np.array([color >> 24 & 255, color >> 16 & 255, color >> 8 & 255]) / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    share = XYZ @ np.clip(vision @ linear, 0.0, 1.0) / WHITE_POINT
    x, y, z = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def difference(one: int, other: int) -> float:
    return min(float(np.linalg.norm(lab(one, seen) - lab(other, seen))) for seen in VISION.values())


def test_colours_differ_with_every_common_colour_vision() -> None:
    assert difference(0xFFFFFFFF, 0x000000FF) == pytest.approx(100.0, abs=0.1)  # by definition
    assert difference(drawing.GREEN, drawing.RED) > 30.0
    assert difference(drawing.COLLISION, drawing.RED) > 20.0
    for other in (*drawing.GROUPS, drawing.GUST, drawing.COLLISION, drawing.GREEN, drawing.RED, drawing.GROUNDED):
        assert difference(drawing.HIT, other) > 15.0, f"{other:08X}"
    for one, other in (*combinations(drawing.LINES[:6], 2), *combinations(blueprint.OUTCOMES.values(), 2)):
        assert difference(one, other) > 15.0, f"{one:08X} {other:08X}"
