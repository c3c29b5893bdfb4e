"""Some of the links of frames, as of `Frames.links`, and the frames that these links use."""

import numpy as np
from numpy.typing import NDArray

from meanflock.kernels.state import Mask


def pick(
    links: NDArray[np.int32], chosen: Mask | None, picked: NDArray[np.int32], used: NDArray[np.intp]
) -> tuple[int, int]:
    """Pick links, and number the frames that they use anew.

    Args:
        links: (K, 2), pairs [frame, UAV]. chosen: (K,), the links to pick; None: all.
        picked: (K, 2), written from its begin: the links with the new numbers of their frames.
        used: (S,), written from its begin: the old numbers of the frames that are used, ascending; S: of all frames.

    Returns:
        The numbers of the links picked, and of the frames used.
    """
    frame, uav = (links if chosen is None else links[chosen]).T
    is_used = np.zeros(len(used), dtype=bool)
    is_used[frame] = True
    frames_used = np.flatnonzero(is_used)
    place = np.cumsum(is_used, dtype=np.int32) - 1  # of a frame among those used
    picked[: len(frame)] = np.stack([place[frame], uav], axis=-1)
    used[: len(frames_used)] = frames_used
    return len(frame), len(frames_used)
