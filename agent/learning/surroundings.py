"""Surroundings of a learner's code: seeded random generators, so many threads, and the kernels of torch."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from meanflock.federation.rules.base import Uploads
from meanflock.swarm import plugins, threads
from meanflock.swarm.errors import FAILURES, BadInput
from meanflock.swarm.global_generators import Generators, global_state
from meanflock.swarm.scenario import Scenario

_UPLOADS = 5  # of the round in which a rule is tried


@contextmanager
def seeded(seed: int, number: int) -> Iterator[None]:
    """Context with seeded global generators, with `number` threads and deterministic kernels; restores them."""
    torch = sys.modules.get("torch")
    with threads.limited(number), Generators(seed):
        if torch is not None:
            # The public `use_deterministic_algorithms` imports the compiler of torch, which takes seconds.
            was = torch._C._get_deterministic_algorithms()
            torch._C._set_deterministic_algorithms(True, warn_only=False)
        try:
            yield
        finally:
            if torch is not None:
                torch._C._set_deterministic_algorithms(was, warn_only=False)


def check_isa(wanted: str) -> None:
    """Check that torch, if it is loaded, computes with the kernels of `training.torch_isa`.

    Raises:
        BadInput: it computes with others.
    """
    torch = sys.modules.get("torch")
    if torch is None or not hasattr(torch, "backends"):
        return
    used = torch.backends.cpu.get_cpu_capability().lower()
    if used != wanted:
        raise BadInput(
            f"torch computes with its kernels {used!r}, and `training.torch_isa` is {wanted!r}, so the bits would "
            f"differ; start Python with {threads.TORCH_ISA}={wanted}, or set training.torch_isa={used}"
        )


def check_rule(scenario: Scenario, parameters: int) -> None:
    """Check that the aggregation rule draws from no global generator, which trainings in the same process seed.

    Raises:
        BadInput: it does.
    """
    federation = scenario.federation
    if not getattr(plugins.load("aggregator", federation.aggregation), "resumable", True):
        return  # it runs at intervals, with generators of its own
    uavs = np.arange(min(scenario.uavs, _UPLOADS))
    models = np.linspace(-1.0, 1.0, len(uavs))[:, None] * np.ones(parameters)
    before = global_state()
    with suppress(*FAILURES):  # the round reports it
        rule = plugins.create("aggregator", federation.aggregation, federation.options, scenario)
        rule.step(rule.init(parameters), Uploads.complete(models, 1, uavs))
    if global_state() != before:
        raise BadInput(
            f"rule {federation.aggregation!r} draws from a global random generator, which trainings seed; draw from "
            "mf.seeds.generator instead"
        )
