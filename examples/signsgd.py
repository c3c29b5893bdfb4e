"""A coding in a file: one bit a number, its sign, times the mean size of its piece (Bernstein et al. 2018).

The rounding errors are fed back to later uploads, as for every coding (Karimireddy et al. 2019).

    meanflock run --plugin examples/signsgd.py --set federation.payload=signsgd
"""

import numpy as np

import meanflock as mf


class SignSGD(mf.Coding):
    """A number is plus or minus the mean size of its piece."""

    name = "signsgd"
    bits = 1

    def encode(self, models):
        return (models.numbers > 0.0).astype(np.uint8), models.scales(models.mean_size)

    def decode(self, numbers, scales):
        return np.where(numbers > 0, scales, -scales)
