"""Surroundings of a learner's code: seeded random generators, so many threads, and the kernels of torch."""

import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from meanflock.federation.rules.base import Uploads
from meanflock.swarm import plugins, threads
from meanflock.swarm.errors import FAILURES, BadInput
from meanflock.swarm.scenario import Scenario

_UPLOADS = 5  # of the round in which a rule is tried


@contextmanager
def seeded(seed: int, number: int) -> Iterator[None]:
    """Context with seeded global generators of Python, NumPy and torch, and with `number` threads; restores them."""
    with threads.limited(number):
        python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002
        torch = sys.modules.get("torch")
        state = None if torch is None else torch.get_rng_state()
        random.seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002
        if torch is not None:
            torch.manual_seed(seed)
            # The public `use_deterministic_algorithms` imports the compiler of torch, which takes seconds.
            was = torch._C._get_deterministic_algorithms()
            torch._C._set_deterministic_algorithms(True, warn_only=False)
        try:
            yield
        finally:
            random.setstate(python)
            np.random.set_state(numpy)  # noqa: NPY002
            if torch is not None:
                torch.set_rng_state(state)
                torch._C._set_deterministic_algorithms(was, warn_only=False)


def global_state() -> tuple[Any, ...]:
    """State of the global generators of Python and NumPy, to compare."""
    numpy: Any = np.random.get_state()  # noqa: NPY002
    return random.getstate(), *(part.tobytes() if isinstance(part, np.ndarray) else part for part in numpy)


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


class Generators:
    """States of the global generators that code has which runs at intervals; a context in which it runs."""

    def __init__(self, seed: int) -> None:
        self._seed: int | None = seed
        self._python: Any = None
        self._numpy: Any = None
        self._torch: Any = None
        self._outer: tuple[Any, Any, Any] = (None, None, None)

    def __enter__(self) -> None:
        torch = sys.modules.get("torch")
        self._outer = random.getstate(), np.random.get_state(), None if torch is None else torch.get_rng_state()  # noqa: NPY002
        if self._seed is not None:
            random.seed(self._seed)
            np.random.seed(self._seed % 2**32)  # noqa: NPY002
            if torch is not None:
                torch.manual_seed(self._seed)
            self._seed = None
            return
        random.setstate(self._python)
        np.random.set_state(self._numpy)  # noqa: NPY002
        if torch is not None and self._torch is not None:
            torch.set_rng_state(self._torch)

    def __exit__(self, *_: object) -> None:
        torch = sys.modules.get("torch")
        self._python, self._numpy = random.getstate(), np.random.get_state()  # noqa: NPY002
        self._torch = None if torch is None else torch.get_rng_state()
        python, numpy, outer = self._outer
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
        if torch is not None and outer is not None:
            torch.set_rng_state(outer)


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
