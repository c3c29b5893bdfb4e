"""Independent random generators, derived from the one seed of a scenario. Each has a name.

A name's position in `STREAMS` is part of the result of every run: append, never reorder.
"""

from typing import Any

import numpy as np

STREAMS = (
    "wind",  # Wiener increments of the motion, in the order (tick, UAV, axis)
    "radio",  # fading of every link, in the order of transmission
    "participants",  # UAVs that upload in a round; every process draws the same set
    "density-fit",  # sample points of the fit of the initial density; every UAV draws the same
    "byzantine",  # UAVs that send false uploads, and the noise in these
    "controller",  # of controllers, by an index of their own, such as tick × N + UAV
    "wind-field",  # modes of the wind field; drawn by the world only
    "alignment",  # pairs whose velocities are compared, by tick; drawn by the world only
    "coding",  # of codings that round at random, by round × N + UAV
    "training",  # seeds of trainings, by round and UAV
    "slowness",  # of a UAV's computer, by UAV
    "shadow",  # field of the radio's shadow: 0 between UAVs, 1 + b to station b
    "sight",  # field of the radio's line of sight, likewise
    "access",  # backoffs of UAVs that contend for the band, in the order of transmission
)


def generator(seed: int, stream: str, index: int = 0) -> np.random.Generator:
    """The generator `stream`, or its `index`-th child; the same arguments always give the same numbers.

    Raises:
        ValueError: `stream` is not one of `STREAMS`.
    """
    if stream not in STREAMS:
        raise ValueError(f"no stream {stream!r}; there are {', '.join(STREAMS)}")
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=(STREAMS.index(stream), index)))


def random_state(generator: np.random.Generator) -> dict[str, Any]:
    """State of a generator as text and 32-bit numbers, which fit into a message."""
    state = generator.bit_generator.state
    inner = {name: str(number) for name, number in state["state"].items()}
    return {"kind": state["bit_generator"], "state": inner, "has": state["has_uint32"], "half": state["uinteger"]}


def set_random_state(generator: np.random.Generator, saved: dict[str, Any]) -> None:
    """Sets the state of a generator to one that `random_state` returned.

    Raises:
        ValueError: the state is of another kind of generator.
    """
    inner = {name: int(digits) for name, digits in saved["state"].items()}
    generator.bit_generator.state = {
        "bit_generator": saved["kind"],
        "state": inner,
        "has_uint32": saved["has"],
        "uinteger": saved["half"],
    }
