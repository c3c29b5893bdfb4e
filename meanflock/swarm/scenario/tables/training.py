"""Table of the learner that UAVs train in flight."""

from typing import Annotated, Any, Literal

from msgspec import field

from meanflock.swarm.scenario.described import OURS, key
from meanflock.swarm.toml import Table as _Table


class Training(_Table, frozen=True):
    """Learner that trains the model of the rounds, beside a controller that shares none."""

    learner: Annotated[
        str,
        key(
            "the learner, see `meanflock plugins`; `none`: the model is the controller's",
            OURS,
            "the paper's controllers have their own model",
        ),
    ] = "none"
    options: Annotated[dict[str, Any], key("options of that learner", OURS, "a learner declares its own")] = field(
        default_factory=dict
    )
    fit_s: Annotated[
        float,
        key("simulated time of a training", OURS, "training is instantaneous", unit="s", ge=0, le=1000000.0),
    ] = 0.0
    example_s: Annotated[
        float,
        key("simulated time for each example of a training", OURS, "likewise", unit="s", ge=0, le=1000000.0),
    ] = 0.0
    spread: Annotated[
        float,
        key(
            "σ, standard deviation of the logarithm of a UAV's slowness, which multiplies its times",
            OURS,
            "all computers are equally fast; 0.5 makes one of six take more than 1.6 times as long",
            ge=0,
            le=10,
        ),
    ] = 0.0
    power_W: Annotated[
        float,
        key(
            "power of a UAV's computer while it trains, for `energy_compute_J`",
            OURS,
            "the paper counts the energy of motion only",
            unit="W",
            ge=0,
        ),
    ] = 0.0
    threads: Annotated[
        int,
        key(
            "threads of BLAS, OpenMP and torch while a learner trains",
            OURS,
            "sums in several threads have other bits",
            ge=1,
            le=1024,
        ),
    ] = 1
    integers: Annotated[
        Literal["send", "keep", "refuse"],
        key(
            "arrays of integers and booleans of the model: `send`: as float32, exact below 2²⁴; `keep`: they stay with "
            "the UAV; `refuse`: the model must have none",
            OURS,
            "counters of batch normalisation are averaged, as in Flower",
        ),
    ] = "send"
    keeps: Annotated[
        tuple[str, ...],
        key(
            'patterns of the names of arrays that stay with the UAV, such as "head.*", besides those of the learner',
            OURS,
            "the whole model is shared",
        ),
    ] = ()
    torch_isa: Annotated[
        Literal["default", "avx2", "avx512"],
        key(
            "instruction set of torch's kernels; torch reads it from ATEN_CPU_CAPABILITY when it first computes",
            OURS,
            "`default` is on every processor, so the bits are the same on all",
        ),
    ] = "default"
