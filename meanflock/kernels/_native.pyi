from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.reference import alignment as alignment
from meanflock.kernels.reference import closest as closest
from meanflock.kernels.reference import columns as columns
from meanflock.kernels.reference import fade as fade
from meanflock.kernels.reference import fly as fly
from meanflock.kernels.reference import interpolate as interpolate
from meanflock.kernels.reference import largest as largest
from meanflock.kernels.reference import learn as learn
from meanflock.kernels.reference import move as move
from meanflock.kernels.reference import multiply as multiply
from meanflock.kernels.reference import nearest as nearest
from meanflock.kernels.reference import neighbours as neighbours
from meanflock.kernels.reference import pairs as pairs
from meanflock.kernels.reference import pick as pick
from meanflock.kernels.reference import poisson as poisson
from meanflock.kernels.reference import reached as reached
from meanflock.kernels.reference import read as read
from meanflock.kernels.reference import repel as repel
from meanflock.kernels.reference import send as send
from meanflock.kernels.reference import solve as solve
from meanflock.kernels.reference import waves as waves
from meanflock.kernels.reference import write as write

SOURCES: int  # `kernels.sources.checksum` of what it was built from

def tables(numbers: NDArray[np.float64], indices: NDArray[np.int32]) -> Any: ...
