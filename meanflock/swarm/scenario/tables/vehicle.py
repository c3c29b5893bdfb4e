"""Tables of the vehicle, and of energy beside that of motion."""

from typing import Annotated, Any, Literal

import numpy as np
from msgspec import field

from meanflock.swarm.scenario.described import OURS, PRINTED, key
from meanflock.swarm.scenario.tables.mission import Places
from meanflock.swarm.state import Floats
from meanflock.swarm.toml import Table as _Table


class VehicleTable(_Table, frozen=True):
    """Vehicle, and constants of the rotary-wing power model, as printed: a craft of a few grams."""

    model: Annotated[
        str,
        key(
            "the vehicle, see `meanflock plugins`",
            PRINTED,
            "double integrator in wind, power of a rotary wing",
            later=True,
        ),
    ] = "point-mass"
    options: Annotated[
        dict[str, Any], key("options of that vehicle", OURS, "a vehicle declares its own", later=True)
    ] = field(default_factory=dict)
    acceleration_max: (
        Annotated[
            float,
            key(
                "limit of the acceleration that a UAV can command; unset: no limit",
                PRINTED,
                "the paper's vehicle has no limit; the leaderboard flies at 6 m/s²",
                unit="m/s²",
                later=True,
                ge=0,
            ),
        ]
        | None
    ) = None
    blade_power: Annotated[
        float,
        key(
            "λ0, profile power of the blades",
            PRINTED,
            "a vehicle of about five grams, which hovers with 0.094 W",
            unit="W",
            ge=0,
        ),
    ] = 0.0049
    induced_power: Annotated[float, key("λ1, induced power in hover", PRINTED, "likewise", unit="W", ge=0)] = 0.0887
    power_speed: Annotated[
        Literal["ground", "air"],
        key(
            "speed that determines the power: over ground, or through the air",
            PRINTED,
            "with `ground`, as printed, drifting with the wind is free; with `air` it costs power",
            later=True,
        ),
    ] = "ground"
    parasite_drag: Annotated[float, key("λ2, parasite drag", PRINTED, "likewise", unit="W s³/m³", ge=0)] = 0.0092
    tip_speed: Annotated[float, key("ω_tip, speed of the blades' tips", PRINTED, "likewise", unit="m/s", gt=0)] = 15.0
    induced_velocity: Annotated[float, key("χ_o, induced velocity in hover", PRINTED, "likewise", unit="m/s", gt=0)] = (
        1.612
    )

    @property
    def file(self) -> str | None:
        """Option `file`: the file from which the vehicle reads the starts of the UAVs; None: it reads none."""
        return self.options.get("file") or None

    @property
    def recorded(self) -> dict[str, Any]:
        """The options of a flight whatever the place of its file, which is known by its hash, the option `sha256`."""
        options = self.options
        return {name: options[name] for name in options if name != "file"} if options.get("sha256") else options

    def power(self, squared: Floats, speed: Floats) -> Floats:
        """Blade profile + induced + parasite power in W, Eq. Power1, at speeds in m/s and their squares; same shape."""
        blade = self.blade_power * (1.0 + 3.0 * squared / self.tip_speed**2)
        # √(1+u²) − u = 1/(√(1+u²) + u): the printed form loses all digits at high speed
        induced = squared / (2.0 * self.induced_velocity**2)
        lift = self.induced_power / np.sqrt(np.sqrt(1.0 + induced * induced) + induced)
        return blade + lift + self.parasite_drag * squared * speed / 2.0


class Energy(_Table, frozen=True):
    """Energy of the radio and of the computer, which is in the summary; and the batteries of the UAVs."""

    radio_W: Annotated[
        float,
        key(
            "power of a transmitter, times its time on air",
            OURS,
            "the paper counts the energy of motion only",
            unit="W",
            ge=0,
        ),
    ] = 0.0
    receive_W: Annotated[
        float,
        key(
            "power of a receiver, times the time on air of what it receives",
            OURS,
            "likewise",
            unit="W",
            later=True,
            ge=0,
        ),
    ] = 0.0
    idle_W: Annotated[
        float,
        key("power of a radio that neither sends nor receives", OURS, "likewise", unit="W", later=True, ge=0),
    ] = 0.0
    step_J: Annotated[
        float, key("energy of one tick of the controller of one UAV", OURS, "likewise", unit="J", ge=0)
    ] = 0.0
    battery_J: (
        Annotated[
            float,
            key(
                "energy in the battery of a UAV at take-off, for motion, radio and computing; unset: without end",
                OURS,
                "the paper's UAVs fly as long as they need",
                unit="J",
                later=True,
                gt=0,
            ),
        ]
        | None
    ) = None
    reserve: Annotated[
        float,
        key(
            "share of a battery at which it is low: its UAV then flies to the nearest landing place, and lands there",
            OURS,
            "no effect without a battery",
            later=True,
            gt=0,
            lt=1,
        ),
    ] = 0.2
    landings: Annotated[
        Places,
        key(
            "landing places of UAVs with a low battery; none: the start of each UAV",
            OURS,
            "likewise",
            unit="m",
            later=True,
        ),
    ] = ()
    empty: Annotated[
        Literal["lands", "falls"],
        key("a UAV whose battery is empty lands where it is, or falls and is lost", OURS, "likewise", later=True),
    ] = "lands"
