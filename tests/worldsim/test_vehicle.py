"""Vehicles of users: they fly and resume, and a wrong one ends the run with its mistake; the limit of acceleration."""

from pathlib import Path

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.plugins import registry
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.checkpoint import Resumption
from meanflock.worldsim.flight import Flight

GLIDER = '''
import msgspec
import numpy as np
from meanflock.worldsim.vehicles.base import Vehicle

class Glider(Vehicle):
    """Its battery drains, and an empty one does not accelerate."""

    name = "glider"

    class Options(Vehicle.Options, frozen=True, kw_only=True):
        charge_J: float = 1.0

    def __init__(self, options, scenario):
        self.charge_J, self.dt = options.charge_J, scenario.dt

    def init(self, uavs):
        return {"charge_J": np.full(uavs, self.charge_J), "flown": np.zeros((uavs, 2), dtype=np.int32)}

    def step(self, states, hidden, acceleration, noise):
        asked = np.where(hidden["charge_J"][:, None] > 0, acceleration, 0.0)
        velocity = states[:, 2:] + self.dt * asked + 0.01 * noise
        spent = self.dt * (asked * asked).sum(axis=-1)
        hidden = {"charge_J": hidden["charge_J"] - spent, "flown": hidden["flown"] + 1}
        return np.concatenate([states[:, :2] + self.dt * velocity, velocity], axis=-1), hidden

    def power(self, states, hidden, acceleration):
        return np.abs(acceleration).sum(axis=-1)
'''


@pytest.fixture
def glider(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Registers the glider, its source changed as told."""
    monkeypatch.setattr(registry, "registered", {})

    def make(*changes: tuple[str, str]) -> None:
        text = GLIDER
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "glider.py"
        path.write_text(text)
        plugins.load_file(path)

    return make


def scenario(*settings: str) -> Scenario:
    return load(None, ["uavs=4", "vehicle.model=glider", *settings])


def test_the_hidden_state_of_a_vehicle_of_a_file_goes_on_with_a_resumed_flight(glider) -> None:
    glider()
    flown = scenario("duration=25", 'stop="duration"', "vehicle.options.charge_J=0.5")
    engine = Engine(flown, "glide", sinks=[kept := Kept()])
    whole = engine.complete()
    assert (engine.world.flight.hidden["flown"] == 250).all()
    carrier = next(block for block in kept.blocks if block.checkpoint)
    tick = carrier.first_tick + len(carrier.states) - 1
    states = np.concatenate([block.states for block in kept.blocks])[: tick + 1]
    resumed = Engine(flown, "glide", resume=Resumption.decode(carrier.checkpoint, states))
    hidden = resumed.world.flight.hidden
    assert hidden["flown"].dtype == np.int32
    assert (hidden["flown"] == tick).all()
    summary = resumed.complete()
    for name in ("trajectory_sha256", "energy_end_mean_J"):
        assert summary[name] == whole[name]


def test_who_leaves_every_bound_is_put_back_with_what_it_hides(glider) -> None:
    glider()
    flight = Flight(scenario())
    flight.advance(np.zeros((4, 2)))
    before, asked = flight.states.copy(), np.zeros((4, 2))
    asked[2] = 1e15
    flight.advance(asked)
    assert flight.status.tolist() == [0, 0, 2, 0]
    np.testing.assert_array_equal(flight.states[2, :2], before[2, :2])
    assert not flight.states[2, 2:].any()
    assert flight.hidden["flown"][:, 0].tolist() == [2, 2, 1, 2]
    assert np.isfinite(flight.energy).all()


ENTRY = "        return np.concatenate("


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("asked * asked).sum(axis=-1)", "asked * asked).sum(axis=-1) / 0", r"charge_J'\] of UAV 0: .* not finite"),
        ("0.01 * noise", "0.01 * noise + np.array([[0], [0], [np.nan], [0]])", "states of UAV 2"),
        (ENTRY, "        velocity = velocity[:3]; states = states[:3]\n" + ENTRY, r"states: float64 \(3, 4\)"),
        (", hidden\n\n", "\n\n", "`step` returns a ndarray"),
        ('"flown": hidden["flown"] + 1}', "}", r"hidden has \['charge_J'\]"),
        (ENTRY, "        states[0] = 0\n" + ENTRY, "ValueError: .*read-only"),
        (ENTRY, "        raise SystemExit(3)\n" + ENTRY, r"`step` failed: SystemExit: 3 \(\w+.py, line \d+\)"),
        ("np.abs(acceleration).sum(axis=-1)", "np.abs(acceleration)", r"power: float64 \(120, 2\)"),
    ],
)
def test_a_wrong_vehicle_ends_the_run_with_its_mistake(glider, old: str, new: str, said: str) -> None:
    glider((old, new))
    engine = Engine(scenario("duration=3"), "wrong")
    with pytest.raises(RunFailed, match=f"vehicle 'glider': .*{said}"), np.errstate(all="ignore"):
        for _ in engine.fly():
            pass


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        ("np.full(3, self.charge_J)", r"hidden\['charge_J'\] has shape \(3,\)"),
        ("self.charge_J", r"hidden\['charge_J'\] is a float"),
        ("exit(3)", "`init` failed: SystemExit: 3"),
    ],
)
def test_a_wrong_take_off_is_refused(glider, hidden: str, said: str) -> None:
    glider(("np.full(uavs, self.charge_J)", hidden))
    with pytest.raises(BadInput, match=f"vehicle 'glider': .*{said}"):
        Flight(scenario())


def test_the_world_shortens_a_command_beyond_the_limit_keeps_its_direction_and_counts_it() -> None:
    flight = Flight(load(None, ["uavs=4", "vehicle.acceleration_max=2", "wind.sigma=0", "wind.drag=0"]))
    commands = np.array([[2.0, 0.0], [3.0, -4.0], [0.0, 2.0 + 1e-12], [0.0, 0.0]])
    flight.lose(np.array([3]), "test", "by the test")
    flight.advance(commands)
    np.testing.assert_allclose(flight.states[:, 2:], 0.1 * np.array([[2.0, 0.0], [1.2, -1.6], [0.0, 2.0], [0.0, 0.0]]))
    assert flight.clipped == 1
    assert flight.effort == pytest.approx([4.0, 4.0, 4.0, 0.0])


@pytest.mark.parametrize("limit", [0.0, 0.05])
@pytest.mark.parametrize("kind", ["none", "ecbf", "braking"])
def test_a_limit_below_what_a_controller_needs_is_flown_and_counted(kind: str, limit: float) -> None:
    behind = [] if kind == "none" else [f"filter.kind={kind}"]
    settings = ["uavs=4", "duration=3", f"vehicle.acceleration_max={limit}", *behind]
    summary = Engine(load(None, settings, method="bvc"), "limited").complete()
    assert summary["ticks"] == 30
    assert summary["lost"] == 0
    assert summary["clipped_uav_ticks"] > 0
    assert summary["control_effort"] <= limit * limit * 3.0 + 1e-9
