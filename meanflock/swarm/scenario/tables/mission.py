"""Tables of the mission: starts, goals, obstacles, wind, and what is measured of it."""

import math
from typing import Annotated, Literal, TypeAlias

from msgspec import Meta

from meanflock.swarm.polygons import Polygon, problem
from meanflock.swarm.scenario.described import OURS, PRINTED, SILENT, key
from meanflock.swarm.state import PLANE
from meanflock.swarm.toml import Point
from meanflock.swarm.toml import Table as _Table

Places: TypeAlias = tuple[Point, ...]


class Start(_Table, frozen=True):
    """Start position, launch time and altitude of every UAV. All start at rest."""

    formation: (
        Annotated[
            Literal["grid", "circle", "streams", "waves", "sphere"],
            key(
                "formation in which the UAVs start; unset: a grid; `sphere` needs space",
                PRINTED,
                "a square whose rows are filled in order; other missions use circle, streams, waves and sphere",
                later=True,
            ),
        ]
        | None
    ) = None
    centre: Annotated[
        Point, key("centre of the formation; in space, its z is `height` if left out", PRINTED, "", unit="m")
    ] = (150.0, 100.0)
    layers: Annotated[
        int,
        key(
            "in space, number of layers of a grid, of waves or of streams, at the distance `spacing`",
            OURS,
            "a formation is level",
            later=True,
            ge=1,
            le=1000,
        ),
    ] = 1
    spacing: Annotated[
        float,
        key(
            "distance of neighbours in grid, waves and streams",
            PRINTED,
            "√2 m; the paper leaves the initial velocity open, ours is 0",
            unit="m",
            gt=0,
        ),
    ] = math.sqrt(2.0)
    radius: Annotated[
        float,
        key(
            "radius of the circle or sphere; for streams, their distance from the crossing at the start",
            OURS,
            "position swaps of this size are common in work on collision avoidance",
            unit="m",
            later=True,
            gt=0,
        ),
    ] = 25.0
    positions: Annotated[
        Places,
        key(
            "start position of each UAV, instead of a formation",
            OURS,
            "for a mission of your own",
            unit="m",
            later=True,
        ),
    ] = ()
    group: Annotated[
        int,
        key(
            "number of UAVs in a wave; they leave at the same time",
            OURS,
            "no effect if all leave at once, except in the formation `waves`",
            unit="UAVs",
            later=True,
            ge=1,
        ),
    ] = 5
    interval: Annotated[
        float,
        key(
            "time between two waves; 0: all UAVs leave at once",
            PRINTED,
            "all UAVs leave at once",
            unit="s",
            later=True,
            ge=0,
            le=1000000.0,
        ),
    ] = 0.0
    height: Annotated[
        float,
        key(
            "altitude h: constant in the plane; in space, z of every place that is given without",
            PRINTED,
            "constant; it does not affect the model",
            unit="m",
            gt=0,
        ),
    ] = 40.0


class Destination(_Table, frozen=True):
    """Goals of the UAVs: the origin for all, or a goal for each."""

    radius: Annotated[
        float,
        key(
            "s_dest: a UAV has arrived when ‖s‖ relative to its goal is at most this",
            SILENT,
            "the norm is as printed, although it adds m and m/s",
            unit="m, m/s",
            gt=0,
        ),
    ] = 5.0
    goals: (
        Annotated[
            Literal["common", "opposite", "across", "parallel", "vertical"],
            key(
                "goals: `common`: the origin; `opposite`: the point opposite the start, through the centre; `across`: "
                "the far side of the crossing; `parallel`: the origin plus the offset of the start from `centre`; "
                "`vertical`, in space: above or below the start, as far from the height of the centre",
                PRINTED,
                "all UAVs have one destination",
                later=True,
            ),
        ]
        | None
    ) = None
    positions: Annotated[
        Places, key("the goal of each UAV, instead of `goals`", OURS, "for a mission of your own", unit="m", later=True)
    ] = ()
    waypoints: Annotated[
        Places,
        key(
            "goals of every UAV, one after another, instead of `goals`; it has arrived at the last one",
            OURS,
            "the paper's UAVs have one goal",
            unit="m",
            later=True,
            max_length=10000,
        ),
    ] = ()
    times_s: Annotated[
        tuple[Annotated[float, Meta(ge=0, le=1e9)], ...],
        key(
            "times at which the goal is at the waypoints; it moves straight between them; unset: a UAV that reaches a "
            "waypoint flies to the next",
            OURS,
            "likewise",
            unit="s",
            later=True,
        ),
    ] = ()
    patrol: Annotated[
        bool, key("whether the first waypoint follows the last, so that no UAV arrives", OURS, "likewise", later=True)
    ] = False


class Obstacle(_Table, frozen=True, omit_defaults=True):
    """A disc or a polygon that no UAV should enter; in space, a column or a sphere. A UAV that enters it is counted and
    flies on."""

    centre: Annotated[Point, Meta(description="centre of a disc; in space, three numbers make it a sphere, m")] = ()
    radius: Annotated[float, Meta(ge=0, description="radius of a disc or a sphere, m")] = 0.0
    height: Annotated[float, Meta(gt=0, description="in space, height of a column; unset: without end, m")] | None = (
        None
    )
    polygon: Annotated[
        tuple[tuple[float, float], ...],
        Meta(max_length=100, description="corners of a polygon in their order around it, in place of a disc, m"),
    ] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.polygon:
            if self.centre or self.radius:
                raise ValueError("a `polygon` has no `centre` and no `radius`; leave these out")
            if found := problem(self.polygon):
                raise ValueError(f"the `polygon` {found}")
        else:
            for name in ("centre", "radius"):
                if not getattr(self, name):
                    raise ValueError(f"it lacks the required key `{name}`; add it, or the corners of a `polygon`")

    @property
    def outline(self) -> Polygon | None:
        """Its polygon; None for a disc, a column around its axis, or a sphere."""
        return Polygon.of(self.polygon, self.height) if self.polygon else None

    @property
    def disc(self) -> tuple[float, float, float]:
        """The disc, or one around the polygon: x, y and radius, m."""
        if (outline := self.outline) is not None:
            return outline.disc
        return self.centre[0], self.centre[1], self.radius

    @property
    def axis(self) -> tuple[float, float]:
        """Lowest and highest point of its upright axis, from which every point within the radius is inside, m."""
        if len(self.centre) > PLANE:
            return self.centre[PLANE], self.centre[PLANE]
        return -math.inf, math.inf if self.height is None else self.height


class Wind(_Table, frozen=True):
    """The Ornstein–Uhlenbeck wind."""

    sigma: Annotated[
        float,
        key(
            "σ_wind, diffusion of velocity",
            PRINTED,
            "it multiplies dW, so it is a standard deviation; the paper calls it a covariance",
            unit="m/s/√s",
            ge=0,
        ),
    ] = 0.1
    mean: Annotated[Point, key("v_o, mean wind", PRINTED, "", unit="m/s")] = (1.0, -1.0)
    drag: Annotated[float, key("c0, drag towards the mean wind", PRINTED, "", unit="1/s", ge=0)] = 0.1
    common: Annotated[
        float,
        key(
            "share of the variance of the wind's noise that all UAVs have in common",
            SILENT,
            "the noise of each UAV is independent of that of all others",
            later=True,
            ge=0,
            le=1,
        ),
    ] = 0.0
    field_rms: Annotated[
        float,
        key(
            "RMS speed of a steady wind field that is added to the mean wind; 0: no field",
            PRINTED,
            "the wind is the same everywhere",
            unit="m/s",
            later=True,
            ge=0,
        ),
    ] = 0.0
    field_length: Annotated[
        float, key("length over which that field varies", OURS, "no effect without a field", unit="m", later=True, gt=0)
    ] = 30.0
    field_modes: Annotated[
        int,
        key(
            "number of waves whose sum is the field",
            OURS,
            "so many that no single wave is visible",
            later=True,
            ge=1,
            le=1000,
        ),
    ] = 64
    profile_exponent: Annotated[
        float,
        key(
            "in space, α of a mean wind that grows with the height z as (z / `start.height`)^α; 0: it does not",
            OURS,
            "the mean wind is the same at all heights",
            later=True,
            ge=0,
            le=1,
        ),
    ] = 0.0
    downwash: Annotated[
        Literal["none", "crazyflie"],
        key(
            "in space, wakes that push UAVs below down: none, or those fitted to the Crazyflie 2.x; at most 2000 UAVs",
            OURS,
            "the paper's UAVs do not disturb each other",
            later=True,
        ),
    ] = "none"


class Truth(_Table, frozen=True):
    """Drag and wind of the world, if they differ from `[wind]`. UAVs know `[wind]` only."""

    drag: (
        Annotated[
            float,
            key("drag of the world, instead of `wind.drag`", PRINTED, "the UAVs are told the truth", unit="1/s", ge=0),
        ]
        | None
    ) = None
    wind: (
        Annotated[Point, key("mean wind of the world, instead of `wind.mean`", PRINTED, "likewise", unit="m/s")] | None
    ) = None


class Metrics(_Table, frozen=True):
    """Radii of the collision metrics."""

    collision_radius: Annotated[
        float,
        key(
            "r_coll, distance below which a pair collides",
            PRINTED,
            "a pair counts once, while both are on the way",
            unit="m",
            gt=0,
        ),
    ] = 0.1
    hazard_radius: Annotated[
        float, key("r_C, distance below which a pair counts for the risk φ_C", PRINTED, "√2/2 m", unit="m", gt=0)
    ] = math.sqrt(2.0) / 2.0
