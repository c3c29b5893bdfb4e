"""The conformance suite of vehicles."""

from typing import Any

import numpy as np

from meanflock.results.quantities import check_columns
from meanflock.swarm import threads
from meanflock.swarm.declared import column_names
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import BEYOND_SENSE
from meanflock.swarm.wire.control import decode_record, encode_record
from meanflock.testing.error import (
    GONE,
    OTHER_THREADS,
    THREADS,
    asked,
    check_class,
    check_kept,
    check_same_form,
    copies,
    fail,
    made,
    make,
    same,
    scenarios,
    with_surroundings,
    without_draws,
)
from meanflock.testing.pace import SLOW_MS, check_pace

UAVS, TICKS = 5, 30
_RANDOM = "all noise is in the argument `noise`"


@threads.limited()
def check_vehicle(
    vehicle: type,
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
) -> None:
    """Moves some UAVs with a vehicle and checks everything that the world relies on.

    Args:
        vehicle: the class. options: those of the table [vehicle.options]. scenario: default: the paper's with five
            UAVs, in each of the declared dimensions. slow_ms: limit of the median time of a tick of all UAVs.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(vehicle, "vehicle")
    options = options or {}
    for flown in scenarios(vehicle, scenario, UAVS):
        if options.get("file"):  # as where a flight is planned
            flown = made(vehicle, options, vehicle.resolve, flown)  # type: ignore[attr-defined]
        _check(vehicle, options, flown, slow_ms)


def _check(vehicle: type, options: dict[str, Any], flown: Scenario, slow_ms: float) -> None:
    draw = np.random.default_rng(3)
    start = draw.normal(0.0, 5.0, (UAVS, flown.state_numbers))
    columns = _columns(vehicle)
    # Commands, noises, and gusts for a vehicle that takes them apart.
    forces = draw.normal(0.0, 1.0, (3 if getattr(vehicle, "push", False) else 2, TICKS, UAVS, flown.dimensions))

    def flown_by(seed: int, rows: slice = slice(None), afresh: bool = False, number: int = 1) -> list[np.ndarray]:
        remedy = GONE if afresh else "any number of UAVs must do"

        def run() -> list[np.ndarray]:
            instance = make(vehicle, options, flown)
            states = start[rows].copy()
            trace = []
            hidden = {name: part[rows] for name, part in _begun(instance, UAVS).items()}
            begun = hidden
            for command, *others in forces[:, :, rows].swapaxes(0, 1):
                if afresh:
                    instance = make(vehicle, options, flown)
                    hidden = {name: np.array(array) for name, array in decode_record(encode_record(hidden)).items()}
                given = [states, command, *others, *hidden.values()]
                before = copies(given)
                answer = asked(vehicle, instance.step, states, hidden, command, *others, remedy=remedy)
                if not isinstance(answer, tuple) or len(answer) != 2:
                    came = f"`step` returns a {type(answer).__name__}"
                    fail(vehicle, came, "return the states and the hidden state")
                states, hidden = answer
                check_kept(vehicle, "hidden", hidden)
                power = asked(vehicle, instance.power, states, hidden, command, remedy=remedy)
                check_same_form(vehicle, "hidden", hidden, begun)
                if not all(same(one, other) for one, other in zip(before, given, strict=True)):
                    fail(
                        vehicle,
                        "`step` or `power` writes to an array it was given",
                        "return new arrays; copy before you write",
                    )
                _check_numbers(vehicle, (len(command), flown.state_numbers), np.asarray(states), np.asarray(power))
                trace += [np.array(states), np.array(power)]
                if columns:
                    trace.append(_shown(instance, hidden, (len(command), columns)))
            return trace

        return with_surroundings(vehicle, _RANDOM, run, seed, number)

    together = flown_by(1)
    flown_by(1, slice(0, 0))
    for again, problem, remedy in (
        (flown_by(2), "the same flight differed in a second run", _RANDOM),
        (flown_by(1, number=OTHER_THREADS), *THREADS),
        (
            flown_by(1, afresh=True),
            "a flight that continues from a checkpoint differs",
            "keep all you remember in `hidden`",
        ),
    ):
        if not all(same(one, other) for one, other in zip(together, again, strict=True)):
            fail(vehicle, problem, remedy)
    for row in range(UAVS):
        alone = flown_by(1, slice(row, row + 1))
        if not all(same(one[row : row + 1], other) for one, other in zip(together, alone, strict=True)):
            fail(vehicle, "a UAV moves differently with others than alone", "compute every row from that row alone")
    with without_draws(vehicle, _RANDOM):
        _check_block(vehicle, make(vehicle, options, flown), start, forces)
    instance, states = make(vehicle, options, flown), start
    hidden = _begun(instance, UAVS)

    def move(number: int) -> None:
        nonlocal states, hidden
        states, hidden = instance.step(states, hidden, *forces[:, number])
        instance.power(states, hidden, forces[0, number])

    check_pace(vehicle, f"a tick of {UAVS} UAVs", slow_ms, move)


def _begun(instance: Any, uavs: int) -> dict[str, np.ndarray]:
    """The hidden state at take-off."""
    hidden: dict[str, np.ndarray] = asked(
        type(instance), instance.init, uavs, remedy="return a dict of arrays, a row a UAV"
    )
    check_kept(type(instance), "hidden", hidden, uavs)
    return hidden


def _columns(vehicle: type) -> int:
    """The number of the columns that a vehicle declares."""
    try:
        names = column_names("`columns`", getattr(vehicle, "columns", ()))
        check_columns("`columns`", names)
        return len(names)
    except BadInput as error:
        fail(vehicle, str(error), "fix the declaration")


def _shown(instance: Any, hidden: dict[str, np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """The numbers that a vehicle shows."""
    remedy = "return a column for each of `columns`"
    shown = np.array(_reading(instance, "shown", hidden, remedy))
    if shown.shape != shape or shown.dtype != np.float64:
        fail(type(instance), f"`shown` returns {shown.dtype} {shown.shape}", f"return finite float64 {shape}")
    if not (np.abs(shown) < BEYOND_SENSE).all():
        fail(type(instance), "`shown` returns a number that is not finite, or too large", "guard divisions and roots")
    return shown


def _check_rest(instance: Any, hidden: dict[str, np.ndarray], begun: dict[str, np.ndarray]) -> None:
    """Check the hidden state at rest of all UAVs, and that of each UAV by itself."""
    vehicle, label = type(instance), "hidden state at rest"
    rest = _reading(instance, "rest", hidden, GONE)
    check_same_form(vehicle, label, rest, begun)
    for name, part in rest.items():
        if not np.isfinite(part).all():
            fail(vehicle, f"{label}[{name!r}] is not finite", "guard divisions and roots")
        for row in range(len(part)):
            alone = asked(
                vehicle, instance.rest, {key: each[row : row + 1] for key, each in hidden.items()}, remedy=GONE
            )
            if not same(part[row : row + 1], np.asarray(alone[name])):
                fail(vehicle, f"the {label} of a UAV depends on others", "compute every row from that row alone")


def _reading(instance: Any, method: str, hidden: dict[str, np.ndarray], remedy: str) -> Any:
    """The result of a method that may only read the hidden state."""
    before = copies(list(hidden.values()))
    answer = asked(type(instance), getattr(instance, method), hidden, remedy=remedy)
    if not all(same(one, other) for one, other in zip(before, hidden.values(), strict=True)):
        fail(type(instance), f"`{method}` writes to the hidden state", "return new arrays; copy before you write")
    return answer


def _check_block(vehicle: type, instance: Any, states: np.ndarray, forces: np.ndarray) -> None:
    """Check that the power of the rows of all ticks at once is that of each tick, and the form of what is at rest."""
    hidden = begun = _begun(instance, len(states))
    flown, each = [], []
    for command, *others in forces.swapaxes(0, 1):
        states, hidden = instance.step(states, hidden, command, *others)
        flown.append((states, hidden))
        each.append(instance.power(states, hidden, command))
    _check_rest(instance, hidden, begun)
    rows = np.concatenate([states for states, _ in flown])
    kept = {name: np.concatenate([parts[name] for _, parts in flown]) for name in hidden}
    remedy = (
        "the world asks for several ticks at once: compute every row from that row alone, keep the rest in `hidden`"
    )
    together = asked(vehicle, instance.power, rows, kept, np.concatenate(forces[0]), remedy=remedy)
    if not same(np.asarray(together), np.concatenate(each)):
        fail(vehicle, "`power` of the rows of several ticks differs from that of each tick", remedy)


def _check_numbers(vehicle: type, shape: tuple[int, int], states: np.ndarray, power: np.ndarray) -> None:
    if states.shape != shape or power.shape != shape[:1]:
        came = f"states {states.shape} and power {power.shape}"
        fail(vehicle, f"{came} of {shape[0]} UAVs", f"return states {shape} and power {shape[:1]}")
    if states.dtype != np.float64 or power.dtype != np.float64:
        fail(vehicle, f"states are {states.dtype} and power is {power.dtype}", "return float64")
    if not (np.isfinite(states).all() and np.isfinite(power).all()):
        fail(vehicle, "a number is not finite", "guard divisions and roots")
    if (power >= BEYOND_SENSE).any():
        fail(vehicle, f"a power of {power.max():g} W", f"return less than {BEYOND_SENSE:g}; a flight ends otherwise")
    if (power < 0).any():
        fail(vehicle, "a power below zero", "return what the motion costs, in watts")
