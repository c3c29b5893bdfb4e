"""A recording shows the diagnostics of any controller under their names."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from rerun.chunk import RrdReader

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import drawing, plots
from meanflock.groundstation.recording.replay import recorded as recorded_of
from meanflock.groundstation.results.series import Reported
from meanflock.swarm import state
from meanflock.swarm.wire.messages import Telemetry
from tests.groundstation.recordings import column, fixed, flight, record, scalars

pytestmark = pytest.mark.usefixtures("strict")


def of_a_stranger(path: Path, names: tuple[str, ...], weights: int) -> list[Telemetry]:
    """Records a flight of a controller that is not installed here and reports these diagnostics and weights."""
    blocks = [
        msgspec.structs.replace(
            block,
            diagnostics=np.ascontiguousarray(block.diagnostics[..., : len(names)]),
            diagnostic_names=names,
            reports=np.ascontiguousarray(block.reports[:, :weights]),
        )
        for block in flight(uavs=4, ticks=60)
    ]
    record(path, blocks, Reported(names, weights), method="nobody-has-it")
    return blocks


def entities(path: Path) -> set[str]:
    return {str(chunk.entity_path).lstrip("/") for chunk in RrdReader(path).stream()}


def test_unknown_diagnostics_are_drawn_under_their_names(tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    blocks = of_a_stranger(path, ("tension", "phi_G"), 0)
    values = np.concatenate([block.diagnostics for block in blocks])[..., 0].astype(np.float64)
    plot = plots.diagnostic("tension")
    assert plot.title == "tension: mean, min, max"
    ticks, lines = scalars(path, plot)
    np.testing.assert_array_equal(ticks, np.arange(1, 60))  # at take-off nothing was reported yet
    values = values[1:]
    np.testing.assert_allclose(lines, np.stack([values.mean(1), values.min(1), values.max(1)], axis=-1))
    assert plots.diagnostic("phi_G").entity in entities(path)  # a name we know, and its look, whoever reports it
    assert not {plots.WEIGHTS, plots.SPREAD.entity, plots.diagnostic("hjb_residual").entity} & entities(path)


def test_trails_have_the_colours_of_phi_g_where_it_is_reported_else_of_speed(tmp_path: Path) -> None:
    for names, entity, ends in (
        (("hjb_residual", "phi_G"), "phi_G", ["φ_G ≤ 0.001", "≥ 1 s⁻²"]),
        (("hjb_residual",), "speed", ["speed 0", "≥ 5 m/s"]),
        ((), "speed", ["speed 0", "≥ 5 m/s"]),
    ):
        path = tmp_path / f"{len(names)}.rrd"
        blocks = of_a_stranger(path, names, 3)
        states = np.concatenate([block.states for block in blocks])
        _, colors = column(path, look.UAVS, "Points2D:colors")
        if entity == "speed":
            np.testing.assert_array_equal(colors, drawing.speed_colors(state.speed(states)))
        else:
            phi = np.concatenate([block.diagnostics for block in blocks])[..., 1]
            np.testing.assert_array_equal(colors, drawing.phi_g_colors(phi))
        said = [fixed(path, f"map/legend/{entity}/{end}", "Points2D:labels") for end in ("low", "high")]
        assert said == [[end] for end in ends]
        assert not {"map/legend/speed", "map/legend/phi_G"} - {f"map/legend/{entity}"} & entities(path)


def test_a_model_of_any_size_is_drawn_with_a_title_that_says_what_of_it(tmp_path: Path) -> None:
    path = tmp_path / "recording.rrd"
    of_a_stranger(path, (), 3)
    np.testing.assert_array_equal(recorded_of([path]).ticks, np.arange(60))
    assert scalars(path, plots.WEIGHTS)[1].shape == (3, 3)
    assert scalars(path, plots.SPREAD)[1].shape == (3, 1)
    assert plots.weights_title(0, Reported((), 3)) == "what UAV 0 has learned: all 3 weights"
    assert plots.weights_title(2, Reported((), 1000)) == "what UAV 2 has learned: 60 of 1000 weights"
    for weights in (0, 1, 2, 59, 60, 61, 1_000_000):
        drawn = Reported((), weights).drawn
        assert len(drawn) == min(weights, 60) == len(set(drawn.tolist()))
        assert all(0 <= number < weights for number in drawn)
