"""A quadrotor as a rigid body, whose attitude controller and rotors work many times within a tick.

The default constants are those of the AscTec Hummingbird in RotorPy (Folk, Paulos and Kumar, arXiv:2306.04485).
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta

from meanflock import kernels
from meanflock.kernels.quadrotor import ATTITUDE, BODY, GRAVITY, POWER, ROTORS, Craft
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.base import Hidden, MeanWind, Vehicle

_FASTEST_HZ = 100_000
_Positive = Annotated[float, Meta(gt=0)]


class Quadrotor(Vehicle):
    """A quadrotor that turns its thrust to the commanded acceleration, under a geometric attitude controller.

    Gusts and the mean wind push it; it tracks its command alone. The x axis of the body stays as near to that of the
    world as the thrust permits, so the yaw is 0 unless it tilts about both axes.
    """

    name = "quadrotor"
    dimensions = (3,)
    push = True
    columns = ("roll_rad", "pitch_rad", "yaw_rad", "thrust_N")

    class Options(Vehicle.Options, frozen=True):
        """Keys of `[vehicle.options]`."""

        mass_kg: Annotated[float, Meta(gt=0, description="mass, kg")] = 0.5
        inertia_kg_m2: Annotated[
            tuple[_Positive, _Positive, _Positive], Meta(description="moments of inertia about x, y and z, kg m²")
        ] = (3.65e-3, 3.68e-3, 7.03e-3)
        arm_m: Annotated[float, Meta(gt=0, description="distance of a rotor from the centre, m")] = 0.17
        k_eta: Annotated[float, Meta(gt=0, description="thrust of a rotor over its squared speed, N s²/rad²")] = 5.57e-6
        k_m: Annotated[float, Meta(gt=0, description="torque of a rotor over its squared speed, N m s²/rad²")] = 1.36e-7
        tau_s: Annotated[float, Meta(gt=0, description="time constant of a rotor's speed, s")] = 0.005
        speed_max_rad_s: Annotated[float, Meta(gt=0, description="largest speed of a rotor, rad/s")] = 1500.0
        k_p: Annotated[float, Meta(gt=0, description="gain of the attitude, 1/s²")] = 544.0
        k_d: Annotated[float, Meta(gt=0, description="gain of the body rates, 1/s")] = 46.64
        rate_hz: Annotated[float, Meta(gt=0, le=_FASTEST_HZ, description="rate of the attitude controller, 1/s")] = (
            500.0
        )

    options: Options

    def __init__(self, options: Options, scenario: Scenario) -> None:
        """
        Raises:
            BadInput: the rotors do not carry the mass, or the attitude controller is unstable.
        """
        super().__init__(options, scenario)
        most = 4.0 * options.k_eta * options.speed_max_rad_s**2
        if not most > (weight := options.mass_kg * GRAVITY):
            raise BadInput(
                f"vehicle 'quadrotor': four rotors at `speed_max_rad_s` lift {most:.3g} N, and `mass_kg` weighs "
                f"{weight:.3g} N; raise `k_eta` or `speed_max_rad_s`, or lower the mass"
            )
        self._steps = max(1, round(scenario.dt * options.rate_hz))
        _check_stable(options, scenario.dt, self._steps)
        step = scenario.dt / self._steps
        self._craft = np.array(
            Craft(
                options.mass_kg,
                *options.inertia_kg_m2,
                options.arm_m,
                options.k_eta,
                options.k_m,
                _lag(step, options.tau_s),
                options.speed_max_rad_s,
                options.k_p,
                options.k_d,
                scenario.wind.drag,
                step,
            )
        )
        self._mean = MeanWind(scenario)
        self._shake = scenario.wind.sigma * math.sqrt(scenario.dt)

    def init(self, uavs: int) -> Hidden:
        """The body of each UAV in hover, see `kernels.quadrotor`."""
        body = np.zeros((uavs, BODY))
        body[:, 0] = 1.0
        body[:, ROTORS] = math.sqrt(self.options.mass_kg * GRAVITY / (4.0 * self.options.k_eta))
        return {"body": body}

    def rest(self, hidden: Hidden) -> Hidden:
        """Hover, so that a UAV that is put back does not tumble."""
        return self.init(len(hidden["body"]))

    def step(  # type: ignore[override]  # with `push`
        self,
        states: state.States,
        hidden: Hidden,
        acceleration: state.Vectors,
        noise: state.Vectors,
        push: state.Vectors,
    ) -> tuple[state.States, Hidden]:
        """All steps of the attitude controller within a tick; then the noise of the point mass, σ_wind dW."""
        outside = push + self.scenario.wind.drag * self._mean(states)
        moved, turned = np.empty(states.shape), np.empty(hidden["body"].shape)
        kernels.fly(
            self._craft,
            np.ascontiguousarray(states),
            np.ascontiguousarray(hidden["body"]),
            np.ascontiguousarray(acceleration),
            outside,
            self._steps,
            moved,
            turned,
        )
        state.velocity(moved)[...] += self._shake * noise
        return moved, {"body": turned}

    def power(self, states: state.States, hidden: Hidden, acceleration: state.Vectors) -> state.Rows:
        """Mechanical power of the rotors, Σ k_m Ω³, its mean over the tick."""
        return hidden["body"][:, POWER]

    def shown(self, hidden: Hidden) -> state.Floats:
        """Roll, pitch and yaw, which turn the axes of the world to those of the body as R_z R_y R_x; and thrust."""
        w, x, y, z = hidden["body"][:, ATTITUDE].T
        roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        rotors = state.parts(hidden["body"][:, ROTORS])
        return np.stack([roll, pitch, yaw, self.options.k_eta * sum(speed * speed for speed in rotors)], axis=-1)


def _lag(step: float, tau: float) -> float:
    """Share of the way to its wanted speed that a rotor covers in a step."""
    return -math.expm1(-step / tau)


def _check_stable(options: Quadrotor.Options, dt: float, steps: int) -> None:
    """Check that small errors of the attitude decay, of the continuous loop and of that with so many steps a tick.

    Linearised about hover, an axis follows φ'' = u, τu' = −k_p φ − k_d φ' − u. Routh: k_d > τ k_p.
    """
    if not options.k_d > (bound := options.tau_s * options.k_p):
        raise BadInput(
            f"vehicle 'quadrotor': `k_d` = {options.k_d:g} makes the attitude unstable: Routh's criterion is "
            f"k_d > tau_s · k_p = {bound:.4g} 1/s; raise `k_d`, or lower `k_p` or `tau_s`"
        )
    if not _decays(options, dt / steps):
        enough, most = steps, int(_FASTEST_HZ * dt)
        while enough <= most and not _decays(options, dt / enough):
            enough += -(-enough // 50)  # two per cent more
        raise BadInput(
            f"vehicle 'quadrotor': the attitude controller with steps of {1e3 * dt / steps:.3g} ms is unstable; "
            + (
                f"its gains need steps of at most {1e3 * dt / enough:.3g} ms: raise `rate_hz` to "
                f"{math.ceil(enough / dt)} or more, or lower `k_d`"
                if enough <= most
                else f"no `rate_hz` up to {_FASTEST_HZ} is enough for its gains: lower `k_d` and `k_p`"
            )
        )


def _decays(options: Quadrotor.Options, h: float) -> bool:
    """Returns whether errors of the attitude decay with steps of h seconds.

    With the lag λ of a step, the steps of `kernels.fly` have the characteristic polynomial
    (z − 1 + λ)(z − 1)² + λ h k_d (z² − 1)/2 + λ h² k_p (z + 1)²/4, whose roots must be within the unit circle.
    """
    lag = _lag(h, options.tau_s)
    p, d = lag * h * h * options.k_p / 4.0, lag * h * options.k_d / 2.0
    roots = np.roots([1.0, lag - 3.0 + p + d, 3.0 - 2.0 * lag + 2.0 * p, lag - 1.0 + p - d])
    return bool(np.abs(roots).max() < 1.0)
