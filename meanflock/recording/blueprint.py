"""The blueprint of a recording: its entities, their fixed look, and the arrangement of the views in Rerun.

`flight.py`, `plots.py` and `disturbances.py` make rows of these entities, `mission_map.py` logs the fixed parts of the
map, which is in metres with the goal at the origin and y up.
"""

import enum
import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from meanflock.federation.plan import plan_of
from meanflock.federation.seat import seat
from meanflock.federation.topology.base import Hop
from meanflock.federation.topology.clusters import Division
from meanflock.recording import drawing, mission_map, plots, space
from meanflock.recording.branches import IN_SPACE, MARKS, ON_MAP, Branch
from meanflock.recording.drawing import Part, circle
from meanflock.results.disk import LARGE_SWARM
from meanflock.results.groups import numbers, uav_names
from meanflock.results.series import Reported
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status

TIMELINE = "sim_time"  # seconds since take-off
TICKS = "tick"

# Entities below MAP are drawn on the plane of flight, or from above; those of the plots are in `plots.py`.
MAP = ON_MAP.root
UAVS = ON_MAP.uavs
VELOCITY = ON_MAP.velocity
TRAILS = ON_MAP.trails
MODEL_LINKS = ON_MAP.model_links
STATE_LINKS = "map/links/states"
COLLISIONS = ON_MAP.marks["collision"]
OBSTACLE_HITS = ON_MAP.marks["hit"]
LEADER = ON_MAP.leader
CLOSE_UP = "map/leader/close_up"  # shown only in the view around the leader
HEADS = "map/heads"
FAULTS = "map/faults"
# Entities of faults, with the UAVs that they hit
HALOS = f"{FAULTS}/halos"
JAMS = f"{FAULTS}/jams"
GUSTS = f"{FAULTS}/gusts"
AREAS, WORDS = f"{FAULTS}/areas", f"{FAULTS}/words"
LANES = "UAVs"
ROUND = "round"
EVENTS = "events"

ARROW_S = 2.0  # seconds of flight that the arrow of a velocity shows
TRAIL_S = 30.0  # length of a trail; a third of it for a large swarm
LINK_S = 1.0  # seconds for which the transmission of a model is shown
MARK_S = 10.0  # seconds for which a collision or an obstacle hit is shown
GUST_S2 = 10.0  # length of a gust's arrow, m per m/s²
JAMS_DRAWN = 200  # jammed links that are drawn, at most
CLOSE_UP_M = 6.0  # half the width of the view around the leader

_IN_A_TAB = 3  # plots
_CANVAS = (16, 19, 26)


class Lane(enum.IntEnum):
    """The state that a UAV's lane shows: its status, or the fault that holds it."""

    FLYING = Status.FLYING
    ARRIVED = Status.ARRIVED
    LOST = Status.LOST
    LANDED = Status.LANDED
    FROZEN = len(Status)
    CUT_OFF = len(Status) + 1
    WAITING = len(Status) + 2  # its group has not joined


LANE_COLORS = {
    Lane.FLYING: drawing.BLUE,
    Lane.ARRIVED: drawing.GREEN,
    Lane.LOST: drawing.GREY,
    Lane.LANDED: drawing.DISC,
    Lane.FROZEN: drawing.FROZEN,
    Lane.CUT_OFF: drawing.CUT,
    Lane.WAITING: drawing.DISC,
}


OUTCOMES = {  # of the uploads of a round: name and colour of a node
    "received": drawing.GREEN,
    "late": drawing.ORANGE,
    "lost": drawing.RED,
    "refused": drawing.VIOLET,
    "silent": drawing.GREY,
    "no part": drawing.DISC,
}
CENTRE = drawing.WHITE  # of the node that averages for all


def lane(name: str, now: Lane) -> str:
    """The text of a UAV's lane, with its name because lanes have none."""
    return f"{name}: {now.name.lower().replace('_', ' ')}"


def _lanes(scenario: Scenario) -> tuple[list[str], list[int]]:
    """The texts of all lanes, and their colours: that of its group for a UAV of a group that flies."""
    lanes = [now for now in Lane if now is not Lane.WAITING or scenario.groups]
    texts = [lane(name, now) for name in uav_names(scenario) for now in lanes]
    colors = [LANE_COLORS[now] for now in lanes] * scenario.uavs
    if scenario.groups:
        own = [drawing.group_color(number) for number in numbers(scenario).tolist()]
        colors[lanes.index(Lane.FLYING) :: len(lanes)] = own
    return texts, colors


def centre(scenario: Scenario) -> int | None:
    """The node that averages the models of a round at last; None if each UAV averages for itself."""
    hops = _hops(scenario)
    return None if hops and hops[-1].is_local else seat(scenario)


def nodes(scenario: Scenario) -> list[str]:
    """Names of the nodes in the graph of a round: the UAVs by number, then the stations."""
    stations = [f"station {number}" for number in range(len(scenario.stations))]
    return [*map(str, range(scenario.uavs)), *stations]


def resolved(scenario: Scenario) -> Scenario:
    """The scenario with the groups that take part in rounds; as given if a plug-in of the flight is not installed."""
    try:
        return plan_of(scenario).scenario
    except BadInput:
        return scenario


def _hops(scenario: Scenario) -> tuple[Hop, ...]:
    try:
        return plan_of(scenario).hops
    except BadInput:  # a plug-in of the recorded flight is not installed here
        return ()


def graph(scenario: Scenario) -> tuple[list[str], NDArray[np.float64]]:
    """Names of the nodes in the graph of a round, and their places, (N + B + outcomes, 2): all nodes, then the key.

    Heads are between their UAVs and the leader.
    """
    angle = np.arange(scenario.nodes) * (2 * math.pi / scenario.nodes)
    radius = max(80.0, 9.0 * scenario.uavs)
    places = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * radius
    middle = centre(scenario)
    if middle is not None:
        places[Division(scenario).heads] *= 0.5
        places[middle] = 0.0
    key = np.stack([np.full(len(OUTCOMES), 1.5), np.linspace(-0.8, 0.8, len(OUTCOMES))], axis=-1) * radius
    return [*nodes(scenario), *OUTCOMES], np.concatenate([places, key])


def log_static(part: Part, scenario: Scenario, reported: Reported) -> None:
    """Logs the fixed look of everything that moves, names and colours of all lines, and the view around the leader."""
    log, size = part.log, rr.Radius.ui_points
    log(MAP, rr.Transform3D(scale=[1.0, -1.0, 1.0]))  # 2-D views are y-down
    names = uav_names(scenario)  # shown under the mouse
    log(UAVS, rr.Points2D.from_fields(radii=size(3.0), labels=names, show_labels=False, draw_order=30.0))
    log(VELOCITY, rr.Arrows2D.from_fields(colors=[drawing.WHITE], radii=size(0.6), draw_order=25.0))
    log(TRAILS, rr.LineStrips2D.from_fields(radii=size(0.9), draw_order=10.0))
    log(MODEL_LINKS, rr.LineStrips2D.from_fields(radii=size(1.0), draw_order=15.0))
    log(STATE_LINKS, rr.LineStrips2D.from_fields(radii=size(0.3), draw_order=14.0))
    in_space = scenario.space.dimensions == state.SPACE
    for kind, mark in MARKS.items():
        if kind != "grounded" or in_space:
            look = rr.LineStrips2D.from_fields(colors=[mark.color], radii=size(mark.thickness), draw_order=40.0)
            log(ON_MAP.marks[kind], look)
    if scenario.federation.station is None:
        log(f"{LEADER}/ring", rr.Points2D([(0.0, 0.0)], radii=size(5.5), colors=[drawing.WHITE], draw_order=20.0))
    log(CLOSE_UP, rr.Transform3D(scale=[1.0, -1.0, 1.0]))  # undoes that of the map
    log(HEADS, rr.Points2D.from_fields(radii=size(5.5), colors=[drawing.HEAD], draw_order=19.0))
    log(HALOS, rr.Points2D.from_fields(radii=size(6.5), draw_order=18.0))
    log(JAMS, rr.LineStrips2D.from_fields(colors=[drawing.JAMMED], radii=size(1.0), draw_order=16.0))
    log(GUSTS, rr.Arrows2D.from_fields(colors=[drawing.GUST], radii=size(0.8), draw_order=26.0))
    log(AREAS, rr.LineStrips2D.from_fields(radii=size(1.5), draw_order=5.0))
    log(WORDS, rr.Points2D.from_fields(colors=[drawing.WHITE], radii=0.0, show_labels=True))

    spread = [plots.SPREAD] if reported.weights else []
    for plot in (
        *plots.of_flight(scenario),
        plots.ROUNDS,
        *map(plots.diagnostic, reported.diagnostics),
        *spread,
    ):
        log(plot.entity, rr.SeriesLines(names=plot.names, colors=drawing.rgba(plot.colors), widths=plot.widths or 2.0))
    log(plots.HITS, rr.SeriesPoints(names="collision", colors=drawing.COLLISION, markers="asterisk", marker_sizes=5.0))
    if reported.weights:
        names = [f"weight {number}" for number in reported.drawn]
        shades = drawing.viridis(np.linspace(0.0, 1.0, len(names)))
        log(plots.WEIGHTS, rr.SeriesLines(names=names, colors=shades, widths=1.0))
    if scenario.uavs <= LARGE_SWARM:
        texts, colors = _lanes(scenario)
        log(LANES, rr.StateConfiguration(values=texts, labels=texts, colors=drawing.rgba(colors)))
        names, places = graph(scenario)
        log(ROUND, rr.GraphNodes(node_ids=names, positions=places))
    _log_close_up(part, scenario)


def _log_close_up(part: Part, scenario: Scenario) -> None:
    """Logs the scale and the radius r_C around the leader, in a frame with y down."""
    edge, hazard = 0.9 * CLOSE_UP_M, scenario.metrics.hazard_radius
    scale = np.array([(-edge, edge - 0.9), (1.0 - edge, edge - 0.9)])
    part.line(f"{CLOSE_UP}/scale", scale, drawing.WHITE, 1.5)
    part.label(f"{CLOSE_UP}/scale/word", (0.5 - edge, edge - 0.9), "1 m", drawing.WHITE)
    part.line(f"{CLOSE_UP}/hazard", circle((0.0, 0.0), hazard), drawing.GREY, 1.0)
    part.label(f"{CLOSE_UP}/hazard/word", (0.0, hazard), f"r_C {hazard:.2g} m", drawing.GREY)


def flight_blueprint(scenario: Scenario, reported: Reported, live: bool) -> rrb.Blueprint:
    """The views of one flight."""
    leader, radius = scenario.federation.leader, scenario.metrics.collision_radius
    trails = f"trails coloured by {'group' if scenario.groups else 'φ_G' if reported.has_phi_g else 'speed'}"
    legend = f"{trails}, arrows reach {ARROW_S:g} s ahead"
    shown = flight_view(scenario, f"swarm map, m: {legend}", f"swarm in space, m: {legend}")
    words = [f"- /{entity}{'/**' * bool(scenario.groups)}" for entity in ("map/start/label", "map/goal/label")]
    words += ["- /map/waypoints/**", "- /map/landings/**"]
    close_up = rrb.Spatial2DView(
        origin=f"/{CLOSE_UP}",
        contents=[f"/{MAP}/**", "- /map/legend/**", *words, f"- /{WORDS}"],
        name=f"{'leader, ' * (scenario.federation.station is None)}UAV {leader}; discs: r_coll {radius:g} m",
        background=_CANVAS,
        visual_bounds=rrb.VisualBounds2D(x_range=[-CLOSE_UP_M, CLOSE_UP_M], y_range=[-CLOSE_UP_M, CLOSE_UP_M]),
        overrides={**_recent(scenario, ON_MAP), UAVS: rr.Points2D.from_fields(radii=radius)},
    )
    in_grid, in_tabs = _learned(leader, reported)
    columns = rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    details: list[rrb.View | rrb.Container] = [
        rrb.TextLogView(origin=f"/{EVENTS}", name="events", columns=columns),
        *_tabs(in_tabs, "learning" if reported.weights else "diagnostics"),
    ]
    front = 0  # the tab in front: the rounds if there are any, else lanes or events
    if scenario.uavs <= LARGE_SWARM:
        lanes = rrb.StateTimelineView(origin=f"/{LANES}", name="UAVs", time_view=whole_flight())
        details = [lanes, *details, rrb.GraphView(origin=f"/{ROUND}", name="last round")]
        if _hops(scenario) and not scenario.faults:
            front = len(details) - 1
    details.append(_series(plots.ROUNDS, "rounds"))
    grid = rrb.Grid(*map(_series, plots.of_flight(scenario)), *in_grid, grid_columns=2)
    below = rrb.Horizontal(close_up, rrb.Tabs(*details, active_tab=front), column_shares=[2, 3])
    return window(rrb.Horizontal(rrb.Vertical(shown, below, row_shares=[4, 3]), grid, column_shares=[1, 1]), live)


def window(views: rrb.Container, live: bool) -> rrb.Blueprint:
    """A window with these views alone; it follows a live flight and plays a finished one from its start."""
    time_panel = rrb.TimePanel(
        state="collapsed",
        timeline=TIMELINE,
        play_state="following" if live else "playing",
        playback_speed=1.0 if live else 10.0,
    )
    others = rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(views, time_panel, *others, auto_layout=False, auto_views=False)


def flight_view(
    scenario: Scenario, name: str, name_in_space: str, part: str = "", maps: int = 1
) -> rrb.Spatial2DView | rrb.Tabs:
    """The map of a flight; of a flight in space, tabs with the view in space and the map.

    Args:
        name, name_in_space: of the map, and of the view in space.
        part: the part of the recording that shows the flight; empty: the whole.
        maps: in the same window.
    """
    root = f"/{part}" if part else ""

    def recent(branch: Branch) -> dict[Any, rrb.VisibleTimeRanges]:
        return {f"{part}/{entity}" if part else entity: last for entity, last in _recent(scenario, branch).items()}

    swarm_map = rrb.Spatial2DView(
        origin=root or "/",
        contents=[f"{root}/{MAP}/**", f"- {root}/{CLOSE_UP}/**"],
        name=name,
        background=_CANVAS,
        visual_bounds=_map_bounds(scenario, maps),
        overrides=recent(ON_MAP),
    )
    if scenario.space.dimensions != state.SPACE:
        return swarm_map
    in_space = rrb.Spatial3DView(
        origin=f"{root}/{IN_SPACE.root}",
        name=name_in_space,
        background=_CANVAS,
        line_grid=False,  # `space.py` draws one that is as large as the mission
        eye_controls=space.eye(scenario, maps),
        overrides=recent(IN_SPACE),
    )
    return rrb.Tabs(in_space, swarm_map)


def trail_seconds(scenario: Scenario) -> float:
    """Length of a trail, s."""
    return TRAIL_S if scenario.uavs <= LARGE_SWARM else TRAIL_S / 3


def _recent(scenario: Scenario, branch: Branch) -> dict[Any, rrb.VisibleTimeRanges]:
    """The time for which trails, links and marks are shown: nothing is logged twice or cleared."""

    def last(seconds: float) -> rrb.VisibleTimeRanges:
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-seconds)
        return rrb.VisibleTimeRanges(timeline=TIMELINE, start=start, end=rr.TimeRangeBoundary.cursor_relative())

    recent = {branch.trails: last(trail_seconds(scenario)), branch.model_links: last(LINK_S)}
    if branch is ON_MAP:
        recent[STATE_LINKS] = last(scenario.dt)
    kinds = [kind for kind in MARKS if kind != "grounded" or scenario.space.dimensions == state.SPACE]
    return recent | {branch.marks[kind]: last(MARK_S) for kind in kinds}


def _map_bounds(scenario: Scenario, maps: int) -> rrb.VisualBounds2D:
    """The bounds of the map with a margin, in the view's own y-down metres."""
    low, high = mission_map.box(scenario)
    margin = mission_map.MARGIN * float(np.max(high - low))
    low = np.array([mission_map.key_box(scenario, maps)[0][0], low[1]])
    return rrb.VisualBounds2D(
        x_range=[low[0] - margin, high[0] + margin], y_range=[-high[1] - margin, -low[1] + margin]
    )


def _learned(leader: int, reported: Reported) -> tuple[list[rrb.View], list[rrb.View]]:
    """Plots of a controller's reports: at most two for the grid, the others for tabs."""
    views: list[rrb.View] = [_series(plots.diagnostic(name)) for name in reported.diagnostics]
    if not reported.weights:
        return views[:2], views[2:]
    weights = rrb.TimeSeriesView(
        origin=f"/{plots.WEIGHTS}",
        name=plots.weights_title(leader, reported),
        axis_x=whole_flight(),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    return [*views[:1], weights], [*views[1:], _series(plots.SPREAD)]


def _tabs(views: list[rrb.View], name: str) -> list[rrb.Container]:
    """Tabs with views below each other."""
    groups = [views[first : first + _IN_A_TAB] for first in range(0, len(views), _IN_A_TAB)]
    return [
        rrb.Vertical(*group, name=name if len(groups) == 1 else f"{name} {number}")
        for number, group in enumerate(groups, 1)
    ]


def _series(plot: plots.Plot, name: str | None = None) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"/{plot.entity}",
        name=name or plot.title,
        axis_x=whole_flight(),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
    )


def whole_flight() -> rrb.TimeAxis:
    """A time axis with the whole flight; by default a plot shows half a minute around the cursor."""
    return rrb.TimeAxis(
        link=rrb.components.LinkAxis.Independent,
        view_range=rr.TimeRange(rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.infinite()),
    )
