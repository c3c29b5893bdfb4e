"""Base class of vehicles, which move UAVs and compute their power; the mean wind that they fly in; and `Physics`, which
calls the vehicle of a scenario and checks its results. No other code checks them.
"""

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.swarm import plugins, state
from meanflock.swarm.errors import FAILURES, BadInput, PluginFailed, last_line
from meanflock.swarm.events import CommandsIgnored
from meanflock.swarm.plugins.guard import check_array, check_bounded, check_memory, check_same_form, check_values
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.seeds import generator

Hidden = dict[str, NDArray]  # each (N, …)


class Vehicle:
    """Base class of vehicles. Derive from it and set `name`, which `vehicle.model` then refers to.

    Row i of every result must depend on row i of the arguments only, so that flights are bit-identical in every mode.
    Arguments must not be written to. Anything besides the states [x, y, vx, vy] (m, m/s; in space also z and vz)
    belongs in `hidden`, which checkpoints store, and not in self.
    """

    plugin_kind: ClassVar = "vehicle"
    name: ClassVar[str] = ""
    dimensions: ClassVar[tuple[int, ...]] = (2,)  # numbers of axes d in which it flies
    obeys: ClassVar[bool] = True  # whether commands have an effect on its motion
    push: ClassVar[bool] = False  # whether `step` gets gusts as an argument of their own
    columns: ClassVar[tuple[str, ...]] = ()  # names, with units, of the C numbers that `shown` returns

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Keys of `[vehicle.options]`, with units and bounds."""

    def __init__(self, options: "Vehicle.Options", scenario: Scenario) -> None:
        """Sets `self.options` and `self.scenario`.

        Args:
            options: an instance of `Options`.
            scenario: all keys. Its `wind` is that of the world, which may differ from the one that UAVs know.
                `meanflock.worldsim.vehicles.base.MeanWind(scenario)` computes its mean at a place.
        """
        self.options, self.scenario = options, scenario

    @classmethod
    def resolve(cls, options: Options, scenario: Scenario) -> Scenario:
        """Returns the scenario with `start.positions` and the option `sha256`, read from a file. By default `scenario`.

        It is called where a flight is planned, if the option `file` is set and one of the two is not. The run folder
        has the result and a copy of the file. The hash of a scenario depends on `sha256`, and not on `file`.
        """
        return scenario

    def init(self, uavs: int) -> Hidden:
        """Returns the hidden state at take-off: finite arrays of numbers or booleans, (uavs, …). Empty by default.

        The rows are those of UAV 0, 1, …
        """
        return {}

    def rest(self, hidden: Hidden) -> Hidden:
        """Returns the hidden state of UAVs that are put back to their last position, at rest. By default `hidden`.

        The rows are those of all UAVs, `hidden` as before the tick; only those of the UAVs that are put back are used.
        """
        return hidden

    def shown(self, hidden: Hidden) -> state.Floats:
        """Returns the numbers named by `columns`, (N, C), finite float64, of UAVs with this hidden state.

        Time series, recordings, plots and exports contain them. With `roll_rad`, `pitch_rad` and `yaw_rad` exports
        show the attitude.
        """
        raise NotImplementedError("a vehicle that declares `columns` must override `shown`")

    @abstractmethod
    def step(
        self, states: state.States, hidden: Hidden, acceleration: state.Vectors, noise: state.Vectors
    ) -> tuple[state.States, Hidden]:
        """Computes the states after one tick.

        Args:
            states: (N, 2d). hidden: the result of `init` or of the last step.
            acceleration: (N, d), m/s², the command plus the gust. noise: (N, d), standard normal.
            push: (N, d), m/s², the gust. Only a vehicle with `push = True` has this fifth argument; `acceleration` is
                then the command alone. A vehicle that tracks commands needs it, or it would obey the gust.

        Returns:
            New states (N, 2d), finite float64, and the new hidden state, with the same names, shapes and dtypes. A UAV
            beyond 10⁹ m or m/s is lost: the world puts it back to its last position, at rest.
        """
        raise NotImplementedError

    @abstractmethod
    def power(self, states: state.States, hidden: Hidden, acceleration: state.Vectors) -> state.Rows:
        """Returns the power in W, (R,), 0 … 10³⁰, of steps under `acceleration` to `states` (R, 2d) and `hidden`.

        The R rows are those of all UAVs in one or several ticks, tick by tick. States and hidden state are those at the
        end of a tick. A vehicle with steps inside of a tick stores their mean power in `hidden`.
        """
        raise NotImplementedError


class MeanWind:
    """Mean wind of the world, without noise: constant, or a function of the place that does not change with time.

    With `wind.profile_exponent` α the constant part is w·(z/`start.height`)^α, zero at the ground. The field has none.

    The field is a sum of M random Fourier modes (Kraichnan, Phys. Fluids 13, 1970), w(r) = Σ a n_m cos(k_m·r + φ_m).
    Wave vectors k_m are normal with standard deviation 1/L an axis, so velocities are correlated over about L. Unit
    vectors n_m ⊥ k_m make the field free of divergence. Phases φ_m are uniform. With a = rms·√(2/M) the mean of ‖w‖²
    is rms².

    Attributes:
        uniform: whether the wind is the same everywhere.
    """

    def __init__(self, scenario: Scenario) -> None:
        wind = scenario.wind
        self._mean = scenario.space.vector(wind.mean)
        self._exponent, self._height = wind.profile_exponent, scenario.start.height
        self._has_field = wind.field_rms > 0.0
        self.uniform = not self._has_field and (self._exponent == 0.0 or not self._mean.any())
        if self._has_field:
            draw = generator(scenario.seed, "wind-field")
            self._waves = draw.standard_normal((wind.field_modes, scenario.dimensions)) / wind.field_length
            self._phases = draw.uniform(0.0, 2.0 * math.pi, wind.field_modes)
            across = _across(self._waves, draw)
            length = np.sqrt(state.dot(across, across))[:, None]
            self._modes = wind.field_rms * math.sqrt(2.0 / wind.field_modes) * (across / length)

    def __call__(self, states: state.States) -> state.Vectors:
        """The wind at each of `states` (..., 2d), `(..., d)`, m/s; `(d,)` if it is the same everywhere."""
        if self.uniform:
            return self._mean
        mean = self._mean
        if self._exponent > 0.0:
            share = np.maximum(states[..., 2], 0.0) / self._height
            mean = mean * np.power(share, self._exponent)[..., None]
        if not self._has_field:
            return mean
        # Products first, then a sum in NumPy's order: a row's bits do not depend on how many rows there are.
        place = state.parts(state.position(states))
        phase = sum(along[..., None] * waves for along, waves in zip(place, self._waves.T, strict=True))
        swing = np.cos(phase + self._phases)
        along = [np.add.reduce(swing * mode, axis=-1) for mode in self._modes.T]
        return mean + np.stack(along, axis=-1)


def _across(waves: state.Floats, draw: np.random.Generator) -> state.Floats:
    """Vectors at right angles to wave vectors (M, d), (M, d); in space their directions around these are drawn."""
    if waves.shape[-1] == state.SPACE:
        return np.cross(waves, draw.standard_normal(waves.shape))
    return np.stack([-waves[:, 1], waves[:, 0]], axis=-1)


BOUND = 1e9  # m or m/s; a UAV beyond it counts as diverged


def ignored(scenario: Scenario) -> Iterator[CommandsIgnored]:
    """An event for each vehicle of a scenario that takes no commands."""
    flown = [scenario.of_group(group) for group in scenario.groups] or [scenario]
    for model, method in dict.fromkeys((one.vehicle.model, one.method) for one in flown):
        if not getattr(plugins.load("vehicle", model), "obeys", True):
            yield CommandsIgnored(0, model, method)


class Moved(NamedTuple):
    """Result of a tick. states: (N, 4). hidden: as of `init`. diverged: (K,), UAVs put back to rest."""

    states: state.States
    hidden: Hidden
    diverged: NDArray[np.intp]


class Physics:
    """The vehicle of a scenario, and the UAVs that have it."""

    def __init__(self, scenario: Scenario, uavs: NDArray[np.intp] | None = None) -> None:
        """
        Args:
            uavs: (M,) ascending, the UAVs that have the vehicle; None: all. All arrays of this class have their rows.

        Raises:
            BadInput: the vehicle is not installed, does not fly in the dimensions of the scenario, or its options do
                not fit.
        """
        chosen = scenario.vehicle
        self._names = np.arange(scenario.uavs) if uavs is None else uavs
        self._uavs = len(self._names)
        self._name = chosen.model
        plugins.check_dimensions("vehicle", chosen.model, scenario.dimensions)
        self._vehicle: Vehicle = plugins.create("vehicle", chosen.model, chosen.options, scenario.flown())
        self.takes_push = bool(getattr(self._vehicle, "push", False))
        self._calm = np.zeros((self._uavs, scenario.dimensions))

    def init(self) -> Hidden:
        """The hidden state of all UAVs at take-off; raises BadInput if `init` of the vehicle fails."""
        try:
            hidden = self._asked("init", self._uavs)
            check_memory("`init`: hidden", hidden, self._uavs)
            for name, part in hidden.items():
                _check_finite(f"hidden[{name!r}] of `init`", part, self._names)
        except (PluginFailed, TypeError, ValueError) as error:
            raise BadInput(f"vehicle {self._name!r}: {error}") from error
        return dict(hidden)

    def step(
        self,
        states: state.States,
        hidden: Hidden,
        acceleration: state.Vectors,
        noise: state.Vectors,
        waiting: NDArray[np.bool_] | None,
        gust: state.Vectors | None = None,
    ) -> Moved:
        """Move all UAVs for one tick, by `Vehicle.step`. UAVs that are `waiting`, (N,), stay at rest.

        `gust` is for a vehicle that takes it apart from `acceleration`; None: there is none.

        Raises:
            PluginFailed: the vehicle raised, or its result is invalid; the message names the vehicle and the UAV.
        """
        arguments: tuple[state.Vectors, ...] = (acceleration, noise)
        if self.takes_push:
            arguments = (acceleration, noise, self._calm if gust is None else gust)
        try:
            return self._moved(states, hidden, arguments, waiting)
        except (PluginFailed, TypeError, ValueError) as error:
            raise PluginFailed(f"vehicle {self._name!r}: {error}") from error

    def power(self, states: state.States, hidden: Hidden, acceleration: state.Vectors) -> state.Rows:
        """The power of the rows of all UAVs in one or several ticks, by `Vehicle.power`, W.

        Raises:
            PluginFailed: see `step`.
        """
        try:
            power = self._asked("power", states, hidden, acceleration)
            check_array("power", power, (len(states),), states.dtype)
            names = self._names[np.arange(len(states)) % self._uavs]
            _check_finite("power", power, names)
            check_bounded("power", power)  # telemetry has the energy as float32
            if power.min(initial=0.0) < 0.0:
                row = int(power.argmin())
                raise ValueError(f"power of UAV {names[row]}: {power[row]:g} W; expected 0 or more")
        except (PluginFailed, TypeError, ValueError) as error:
            ticks = len(states) // self._uavs
            rows = "" if ticks == 1 else f" (of the rows of {ticks} ticks of {self._uavs} UAVs)"
            raise PluginFailed(f"vehicle {self._name!r}: {error}{rows}") from error
        return power

    def shown(self, hidden: Hidden, columns: int) -> state.Floats:
        """The numbers (N, columns) that the vehicle shows of all UAVs, by `Vehicle.shown`.

        Raises:
            PluginFailed: see `step`.
        """
        for part in hidden.values():
            part.setflags(write=False)
        try:
            shown = self._asked("shown", hidden)
            check_array("shown", shown, (self._uavs, columns), np.dtype(float))
            _check_finite("shown", shown, self._names)
            check_bounded("shown", shown)  # telemetry has it as float32
        except (PluginFailed, TypeError, ValueError) as error:
            raise PluginFailed(f"vehicle {self._name!r}: {error}") from error
        return shown

    def _moved(
        self,
        states: state.States,
        hidden: Hidden,
        arguments: tuple[state.Vectors, ...],
        waiting: NDArray[np.bool_] | None,
    ) -> Moved:
        for array in (states, *hidden.values()):
            array.setflags(write=False)
        answer = self._asked("step", states, dict(hidden), *arguments)
        moved, changed = check_values("step", answer, 2, "states and hidden state")
        check_array("states", moved, states.shape, states.dtype)
        check_same_form("hidden", changed, hidden)
        for name, part in changed.items():
            _check_finite(f"hidden[{name!r}]", part, self._names)
        moved, diverged = np.ascontiguousarray(moved), state.NO_UAV
        if not kernels.largest(moved) < BOUND:
            far = ~(np.abs(moved) < BOUND).all(axis=-1)  # NaN is below nothing
            finite = np.isfinite(arguments[0]).all(axis=-1)
            _check_finite("states", moved[far & finite], self._names[far & finite])
            moved, diverged = moved.copy(), np.flatnonzero(far)
            moved[far] = states[far]
            state.velocity(moved)[far] = 0.0
            rest = self._asked("rest", dict(hidden))
            check_same_form("hidden state at rest", rest, hidden)
            for name, part in rest.items():
                _check_finite(f"hidden[{name!r}] at rest", part[diverged], self._names[diverged])
            changed = {name: _put_back(part, rest[name], diverged) for name, part in changed.items()}
        if waiting is not None:
            still = np.flatnonzero(waiting)
            moved = _put_back(moved, states, still)
            changed = {name: _put_back(part, hidden[name], still) for name, part in changed.items()}
            diverged = diverged[~waiting[diverged]]
        return Moved(moved, changed, diverged)

    def _asked(self, method: str, *arguments: Any) -> Any:
        try:
            return getattr(self._vehicle, method)(*arguments)
        except FAILURES as error:
            raise PluginFailed(f"`{method}` failed: {last_line(error)}") from error


def _check_finite(label: str, array: NDArray, uavs: NDArray[np.intp]) -> None:
    """Check that an array has finite numbers only; its rows are those of `uavs`."""
    if np.count_nonzero(finite := np.isfinite(array)) < array.size:
        row = int(np.flatnonzero(~finite.reshape(len(array), -1).all(axis=-1))[0])
        raise ValueError(f"{label} of UAV {uavs[row]}: {array[row]} is not finite")


def _put_back(part: NDArray, before: NDArray, rows: NDArray[np.intp]) -> NDArray:
    part = part.copy()
    part[rows] = before[rows]
    return part
