"""How a recording opens in Rerun: the fixed parts of every entity and the arrangement of the views.

`recording_*.py` and `disturbances.py` fill the entities named here, `legend.py` draws what of the map stays where it
is; the plots are in `panels.py`, the colours in `palette.py`.
The map is in metres with the goal at the origin and y up.
"""

import enum
import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from meanflock.groundstation.recording import mission, palette, panels
from meanflock.groundstation.recording.part import Part
from meanflock.groundstation.recording.plot_views import learned, series, tabs, whole_flight
from meanflock.groundstation.reported import Reported
from meanflock.swarm.clusters import Clusters
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status

TIMELINE = "sim_time"  # seconds since take-off
TICKS = "tick"

# Entities. What lies under MAP is drawn on the plane of flight, what lies under PLOTS over time.
MAP = "map"
UAVS = "map/uavs"
VELOCITY = "map/velocity"
TRAILS = "map/trails"
MODEL_LINKS = "map/links/models"
STATE_LINKS = "map/links/states"
COLLISIONS = "map/collisions"
OBSTACLE_HITS = "map/obstacle_hits"
LEADER = "map/leader"
CLOSE_UP = "map/leader/close_up"  # what the view around the leader alone shows
HEADS = "map/heads"
FAULTS = "map/faults"
HALOS, JAMS, GUSTS = f"{FAULTS}/halos", f"{FAULTS}/jams", f"{FAULTS}/gusts"  # with the UAVs they hit
AREAS, WORDS = f"{FAULTS}/areas", f"{FAULTS}/words"
LANES = "UAVs"
ROUND = "round"
EVENTS = "events"


LARGE_SWARM = 200  # UAVs; a larger swarm is recorded more coarsely, or its recording costs more than its flight
ARROW_S = 2.0  # an arrow reaches to where its UAV will be this much later, s
TRAIL_S = 30.0  # length of a trail, s; a third of it for a large swarm
LINK_S = 1.0  # how long a model's way through the air stays visible, s
STAR_S = 10.0  # how long a collision or an obstacle hit stays on the map, s
GUST_S2 = 10.0  # a gust's arrow, as that of a velocity so many seconds long would be: m per m/s²
JAMS_DRAWN = 200  # links that a script jams, at the most
CLOSE_UP_M = 6.0  # half the width of the close-up on the leader

_CANVAS = (16, 19, 26)


class Lane(enum.IntEnum):
    """What a UAV's lane says: its status, or the fault that holds it."""

    FLYING = Status.FLYING
    ARRIVED = Status.ARRIVED
    LOST = Status.LOST
    FROZEN = len(Status)
    CUT_OFF = len(Status) + 1


LANE_COLORS = {
    Lane.FLYING: palette.BLUE,
    Lane.ARRIVED: palette.GREEN,
    Lane.LOST: palette.GREY,
    Lane.FROZEN: palette.FROZEN,
    Lane.CUT_OFF: palette.CUT,
}


def lane(uav: int, now: Lane) -> str:
    """What a UAV's lane reads; the number is in it because lanes have no names."""
    return f"UAV {uav}: {now.name.lower().replace('_', ' ')}"


def graph(flown: Scenario) -> tuple[list[str], NDArray[np.float64]]:
    """Names of the UAVs in the graph of a round, and where they are, (N, 2)."""
    angle = np.arange(flown.uavs) * (2 * math.pi / flown.uavs)
    places = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * max(80.0, 9.0 * flown.uavs)
    places[Clusters(flown).heads] *= 0.5  # of clusters, between their UAVs and the leader
    places[flown.federation.leader] = 0.0
    return [str(uav) for uav in range(flown.uavs)], places


def log_static(stream: Part, scenario: Scenario, reported: Reported) -> None:
    """Logs what does not change in flight: how marks look that move, and names and colours of all series."""

    log, size = stream.log, rr.Radius.ui_points
    log(MAP, rr.Transform3D(scale=[1.0, -1.0, 1.0]))  # 2-D views are y-down
    numbers = [f"UAV {uav}" for uav in range(scenario.uavs)]  # of the one under the mouse
    dots = rr.Points2D.from_fields(radii=size(3.0), labels=numbers, show_labels=False, draw_order=30.0)
    log(UAVS, dots)
    log(VELOCITY, rr.Arrows2D.from_fields(colors=[palette.WHITE], radii=size(0.6), draw_order=25.0))
    log(TRAILS, rr.LineStrips2D.from_fields(radii=size(0.9), draw_order=10.0))
    log(MODEL_LINKS, rr.LineStrips2D.from_fields(radii=size(1.0), draw_order=15.0))
    log(STATE_LINKS, rr.LineStrips2D.from_fields(radii=size(0.3), draw_order=14.0))
    log(COLLISIONS, rr.LineStrips2D.from_fields(colors=[palette.COLLISION], radii=size(1.2), draw_order=40.0))
    log(OBSTACLE_HITS, rr.LineStrips2D.from_fields(colors=[palette.HIT], radii=size(1.5), draw_order=40.0))
    log(f"{LEADER}/ring", rr.Points2D([(0.0, 0.0)], radii=size(5.5), colors=[palette.WHITE], draw_order=20.0))
    log(CLOSE_UP, rr.Transform3D(scale=[1.0, -1.0, 1.0]))  # undoes that of the map: the view's origin has y down again
    log(HEADS, rr.Points2D.from_fields(radii=size(5.5), colors=[palette.HEAD], draw_order=19.0))
    log(HALOS, rr.Points2D.from_fields(radii=size(6.5), draw_order=18.0))
    log(JAMS, rr.LineStrips2D.from_fields(colors=[palette.JAMMED], radii=size(1.0), draw_order=16.0))
    log(GUSTS, rr.Arrows2D.from_fields(colors=[palette.GUST], radii=size(0.8), draw_order=26.0))
    log(AREAS, rr.LineStrips2D.from_fields(radii=size(1.5), draw_order=5.0))
    log(WORDS, rr.Points2D.from_fields(colors=[palette.WHITE], radii=0.0, show_labels=True))

    plots = [*panels.OF_EVERY_FLIGHT, *map(panels.diagnostic, reported.diagnostics)]
    for plot in plots + [panels.SPREAD] * (reported.weights > 0):
        log(plot.entity, rr.SeriesLines(names=plot.names, colors=_rgba(plot.colors), widths=plot.widths or 2.0))
    log(panels.HITS, rr.SeriesPoints(names="collision", colors=palette.COLLISION, markers="asterisk", marker_sizes=5.0))
    if reported.weights:
        names = [f"weight {number}" for number in reported.drawn]
        shades = palette.viridis(np.linspace(0.0, 1.0, len(names)))
        log(panels.WEIGHTS, rr.SeriesLines(names=names, colors=shades, widths=1.0))
    if scenario.uavs <= LARGE_SWARM:
        texts = [lane(uav, now) for uav in range(scenario.uavs) for now in Lane]
        colors = _rgba(tuple(LANE_COLORS[now] for now in Lane) * scenario.uavs)
        log(LANES, rr.StateConfiguration(values=texts, labels=texts, colors=colors))


def blueprint(scenario: Scenario, reported: Reported, live: bool) -> rrb.Blueprint:
    """The views, arranged; a live recording follows the flight, a finished one plays it from the start."""
    leader, radius = scenario.federation.leader, scenario.metrics.collision_radius
    trails = f"trails coloured by {'φ_G' if reported.has_phi_g else 'speed'}"
    maps = swarm_map(scenario, f"swarm map, m: {trails}, arrows reach 2 s ahead")
    close_up = rrb.Spatial2DView(
        origin=f"/{CLOSE_UP}",
        contents=[f"/{MAP}/**", "- /map/legend/**", "- /map/start/label", "- /map/goal/label", f"- /{WORDS}"],
        name=f"leader, UAV {leader}; discs: r_coll {radius:g} m",
        background=_CANVAS,
        visual_bounds=rrb.VisualBounds2D(x_range=[-CLOSE_UP_M, CLOSE_UP_M], y_range=[-CLOSE_UP_M, CLOSE_UP_M]),
        overrides={**_recent(scenario), UAVS: rr.Points2D.from_fields(radii=radius)},
    )
    of_grid, beside = learned(leader, reported)
    said = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    details: list[rrb.View | rrb.Container] = [
        rrb.TextLogView(origin=f"/{EVENTS}", name="events", columns=said),
        *tabs(beside, "learning" if reported.weights else "diagnostics"),
    ]
    if scenario.uavs <= LARGE_SWARM:
        lanes = rrb.StateTimelineView(origin=f"/{LANES}", name="UAVs", time_view=whole_flight())
        details = [lanes, *details, rrb.GraphView(origin=f"/{ROUND}", name="last round")]
    grid = rrb.Grid(*map(series, panels.OF_EVERY_FLIGHT), *of_grid, grid_columns=2)
    below = rrb.Horizontal(close_up, rrb.Tabs(*details, active_tab=0), column_shares=[2, 3])
    return shown(rrb.Horizontal(rrb.Vertical(maps, below, row_shares=[4, 3]), grid, column_shares=[1, 1]), live)


def shown(views: rrb.Container, live: bool) -> rrb.Blueprint:
    """Views, and nothing else of the viewer; it follows a live flight and plays a finished one from its start."""
    time_panel = rrb.TimePanel(
        state="collapsed",
        timeline=TIMELINE,
        play_state="following" if live else "playing",
        playback_speed=1.0 if live else 10.0,
    )
    others = rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(views, time_panel, *others, auto_layout=False, auto_views=False)


def swarm_map(scenario: Scenario, name: str, part: str = "", maps: int = 1) -> rrb.Spatial2DView:
    """The map of a flight; `part`: under which its entities lie, where it is not alone in its recording. maps: in the
    same window.
    """
    root = f"/{part}" if part else ""
    return rrb.Spatial2DView(
        origin=root or "/",
        contents=[f"{root}/{MAP}/**", f"- {root}/{CLOSE_UP}/**"],
        name=name,
        background=_CANVAS,
        visual_bounds=_map_bounds(scenario, maps),
        overrides={f"{part}/{entity}" if part else entity: last for entity, last in _recent(scenario).items()},
    )


def trail_seconds(scenario: Scenario) -> float:
    """How long a trail is, s."""
    return TRAIL_S if scenario.uavs <= LARGE_SWARM else TRAIL_S / 3


def _rgba(colors: tuple[int, ...]) -> NDArray[np.uint32]:
    """As rerun wants to be told that these are colours and not channels."""
    return np.array(colors, dtype=np.uint32)


def _recent(scenario: Scenario) -> dict[Any, rrb.VisibleTimeRanges]:
    """Trails, links and stars are drawn while their rows are recent: nothing is logged twice or cleared."""

    def last(seconds: float) -> rrb.VisibleTimeRanges:
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-seconds)
        return rrb.VisibleTimeRanges(timeline=TIMELINE, start=start, end=rr.TimeRangeBoundary.cursor_relative())

    return {
        TRAILS: last(trail_seconds(scenario)),
        MODEL_LINKS: last(LINK_S),
        STATE_LINKS: last(scenario.dt),
        COLLISIONS: last(STAR_S),
        OBSTACLE_HITS: last(STAR_S),
    }


def _map_bounds(scenario: Scenario, maps: int) -> rrb.VisualBounds2D:
    """What the map shows with a margin, in the view's own y-down metres."""
    low, high = mission.box(scenario)
    margin = mission.MARGIN * float(np.max(high - low))
    low = np.array([mission.key_box(scenario, maps)[0][0], low[1]])
    return rrb.VisualBounds2D(
        x_range=[low[0] - margin, high[0] + margin], y_range=[-high[1] - margin, -low[1] + margin]
    )
