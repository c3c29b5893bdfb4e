"""The grid of experiments: records, points, tables, carried models; damaged files fly again; measures of the theory."""

import json
import math
import shutil
from collections import Counter
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meanflock.launch.engine import Engine
from meanflock.studies import job_file, runner
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.vehicles.point_mass import PointMass
from research.reproduction import claims, experiments, flight, grid, measure, page, tables, theory
from research.reproduction.experiments import run_grid
from research.reproduction.grid import Method, Point, Wanted
from research.reproduction.tables import COORDINATES, Results
from tests.golden.flights import steady
from tests.methods import METHODS

RTOL = 1e-9
FIRST = grid.FIRST_SEED
# The record of the paper's scenario, seed 1, 60 s, from an independent recorder: scalars of `runs.parquet`; of each
# series column the number of finite values, their mean and the last; sums of the models.
RECORDED: dict[str, Any] = json.loads(Path(__file__).with_name("grid_runs.json").read_text(encoding="utf-8"))


def tiny(method: str, *settings: str, uavs: int = 3, duration: float = 3.0) -> Any:
    return load(None, settings, method=method, uavs=uavs, duration=duration, stop="duration")


def plan() -> list[Wanted]:
    points = [
        Point("s0", tiny("mfgfl-hf", "federation.period=10")),
        Point("s0", tiny("hjb")),
        Point("uavs", tiny("mfgfl-hf", "federation.period=10")),
        Point("offline", tiny("offline", "start.spacing=6"), "start.spacing=6"),
        Point("trained", tiny("mfgfl-hf", "wind.sigma=1.5"), training=tiny("mfgfl-hf")),
        Point("sensitivity", tiny("mfg", "learner.kappa=0.1"), "learner.kappa=0.1"),
    ]
    return [Wanted(point, seed) for point in points for seed in (FIRST, FIRST + 1)]


def fly(out: Path, **options: Any) -> Results:
    return run_grid(out, 1, jobs=1, quiet=True, plan=plan(), **options)


def small(method: str, *settings: str, uavs: int = 6, seed: int = 1, duration: float = 15.0) -> Scenario:
    return load(None, ["federation.period=20", *settings], method=method, uavs=uavs, seed=seed, duration=duration)


@pytest.mark.parametrize("method", list(Method))
def test_the_record_has_the_known_numbers(method: Method) -> None:
    expected = RECORDED[method]
    flown = flight.fly(load(None, ["stop=duration"], method=method, seed=1, duration=60.0))
    scalars = experiments.scalars(flown)
    for name, value in expected["scalars"].items():
        assert scalars[name] == (value if value is None else pytest.approx(value, rel=RTOL)), name
    for name, (count, *mean_and_last) in expected["series"].items():
        values = flown.record.series[name]
        finite = values[np.isfinite(values)]
        assert len(finite) == count
        assert not count or [finite.mean(), finite[-1]] == pytest.approx(mean_and_last, rel=RTOL), name
    assert [np.abs(flown.models).sum(), flown.models[-1].sum()] == pytest.approx(expected["models"], rel=RTOL)


def test_a_flight_whose_learners_diverge_is_marked() -> None:
    settings = ("learner.position_scale=40", "learner.velocity_scale=4", "stop=duration")
    flown = flight.fly(small("mfgfl-hf", *settings, duration=30.0))
    assert flown.summary["lost"] > 0
    assert flown.record.scalars["diverged"] is True
    assert flown.record.series["lost"][-1] == flown.summary["lost"]
    assert np.isfinite(flown.record.series["value_norm_max"]).all()
    alone = flight.fly(small("mfgfl-hf", uavs=1)).record.series  # a swarm without pairs
    assert np.isnan([alone["phi_C_distinct"], alone["pair_distance_m"]]).all()


def test_a_traced_flight_is_the_flight_and_its_bill_begins_with_the_mission_plan() -> None:
    scenario = small("mfgfl-hf", "stop=duration", seed=3, duration=12.0)
    flown = flight.fly(scenario, traced=True)
    assert flown.summary["trajectory_sha256"] == Engine(scenario, "alone").complete()["trajectory_sha256"]
    assert flown.record.series["bits"][[0, -1]].tolist() == [6 * 4 * 32, flown.summary["payload_bits"]["total"]]
    trace = flown.record.trace
    assert trace.states.shape == (61, 6, 4)
    np.testing.assert_allclose(trace.weights[-1], flown.models[0], rtol=1e-6)


def test_numbers_at_an_instant_are_those_of_a_flight_that_ends_there() -> None:
    longer, shorter = (small("mfgfl-h", "stop=duration", duration=end) for end in (180.0, 175.0))
    scalars, summary = flight.fly(longer).record.scalars, flight.fly(shorter).summary
    for name in ("phi_A", "phi_C", "phi_C_distinct", "collisions"):
        assert scalars[f"{name}_175"] == pytest.approx(summary[name], rel=1e-12), name
    assert scalars["bits_175"] == summary["payload_bits"]["total"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished plan."""
    out = tmp_path_factory.mktemp("kept")
    fly(out)
    return out


def test_the_grid_flies_every_experiment_and_method_of_the_claims() -> None:
    points = list(grid.points())
    assert {point.experiment for point in points} == set(grid.EXPERIMENTS)
    assert all(point.flown.stop == "duration" and point.flown.max_ticks == 3000 for point in points)
    flown = {(point.experiment, str(point.flown.method)) for point in points}
    for check in (check for claim in (*claims.load(), *claims.own()) for check in claim.check):
        others = () if check.kind == "best" else check.against  # a best case uses the comparisons that exist
        methods = (*check.subject, *others) if check.source == "runs" else ()
        assert set(product(check.experiments or (check.experiment,), methods)) <= flown, check
    (trained,) = [point for point in points if point.training is not None]
    assert trained.flown.wind.sigma == 1.5


def test_experiments_share_runs_and_the_longest_run_flies_first() -> None:
    rows = grid.wanted(3)
    left = experiments.to_do(rows, {})
    assert Counter(run.key for run in left) == Counter({row.key for row in rows})
    assert [experiments.work(run) for run in left] == sorted(map(experiments.work, left), reverse=True)
    assert {run.point.experiment for run in left if run.traced} == {"s0", "offline", "trained", "held-back"}
    seeds = {name: {row.seed for row in rows if row.point.experiment == name} for name in grid.EXPERIMENTS}
    assert seeds.pop("map") == seeds.pop("exchanged-map") == {6001, 6002}
    assert seeds.pop("found") == {grid.FRESH_SEED + k for k in range(3)}
    assert {min(found) for found in seeds.values()} == {FIRST}
    assert max(map(max, seeds.values())) < grid.FRESH_SEED


def test_the_tables_have_the_documented_columns(kept: Path) -> None:
    results = tables.load(kept)
    runs = results.runs.to_pylist()
    assert [(row["experiment"], row["method"], row["seed"]) for row in runs] == [
        (run.point.experiment, run.scenario.method, run.seed) for run in plan()
    ]
    assert results.runs.schema.names[: len(COORDINATES)] == COORDINATES.names
    words = set((tables.__doc__ or "").replace(",", " ").replace("(", " ").split())
    columns = {*results.runs.column_names, *results.series.column_names}
    promised = {"t_avg_s", "key", "uplink_outage_rate", "phi_G_125", "value_norm_max", *results.series.column_names}
    assert promised <= words & columns
    hf, offline = runs[0], next(row for row in runs if row["experiment"] == "offline")
    assert (hf["period"], hf["sigma"], hf["setting"], hf["trained"]) == (10, 0.1, "", False)
    assert (offline["hjb_residual_max"], offline["period"], hf["phi_A_175"]) == (None, None, None)
    first = results.series.to_pylist()[0]
    assert (first["t_s"], first["hjb_abs_mean"]) == (0.0, None)
    with_series = {(row["experiment"], row["method"], row["seed"]) for row in results.series.to_pylist()}
    assert len(with_series) == len(runs) - 2
    assert ("sensitivity", "mfg", FIRST) not in with_series
    traced = {(row["experiment"], row["method"], row["seed"]) for row in results.trajectories.to_pylist()}
    flown = (("s0", "mfgfl-hf"), ("s0", "hjb"), ("offline", "offline"), ("trained", "mfgfl-hf"))
    assert traced == {(*each, FIRST) for each in flown}
    assert len(results.weights["model"][0].as_py()) == 246


def test_the_page_tells_of_the_flights_of_a_folder(kept: Path) -> None:
    lines = page.of_flights(kept)
    assert lines["how it was run"][0] == f"The flights are of code {flight.version()}."
    offline = sum(run.point.experiment == "offline" for run in plan())
    assert any(line.startswith(f"| offline | offline | {offline} |") for line in lines["how it was run"])
    text = page.PAGE.read_text(encoding="utf-8")
    assert all(text.count(page.RUN.format(name)) == 1 for name in lines)


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "foreign"])
def test_a_damaged_file_flies_again(kept: Path, tmp_path: Path, monkeypatch, damage: str) -> None:
    flown, whole, executed = Path(shutil.copytree(kept, tmp_path / "flown")), tables.load(kept), set()
    execute = experiments.execute
    monkeypatch.setattr(experiments, "execute", lambda run: executed.add(run.key) or execute(run))
    path = sorted((flown / "data/jobs").glob("*.job"))[0]
    raw = path.read_bytes()
    flipped = bytearray(raw)
    flipped[len(raw) // 2] ^= 1
    path.write_bytes(
        {"cut": raw[: len(raw) // 2], "flipped": bytes(flipped), "empty": b"", "foreign": b"hello"}[damage]
    )
    assert fly(flown) == whole
    assert 0 < len(executed) < whole.runs.num_rows - 2


def test_the_version_depends_on_the_code_and_not_on_its_docstrings(tmp_path, monkeypatch) -> None:
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr(job_file, "_ROOMS", (SimpleNamespace(__file__=str(tmp_path / "__init__.py")),))

    def version(source: str, other: str = "") -> str:
        (tmp_path / "folder" / "module.py").write_text(source)
        (tmp_path / "other.txt").write_text(other)
        return str(job_file.version.__wrapped__(tmp_path / "other.txt"))

    before = version('def f() -> int:\n    """One."""\n    return 1\n')
    assert version('def f() -> int:\n    """Two words."""\n    # why\n    return 1\n') == before
    assert version('def f() -> int:\n    """One."""\n    return 2\n') != before
    assert version('def f() -> int:\n    """One."""\n    return 1\n', other="a = 1") != before


def test_bad_options_are_rejected_before_a_folder_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    monkeypatch.setattr(runner, "SCHEDULER_TIMEOUT", "1s")
    nobody = {"backend": "dask", "scheduler": "tcp://127.0.0.1:9"}
    for options in ({"only": {"s1"}}, {"backend": "ray"}, {"scheduler": "tcp://127.0.0.1:1"}, nobody):
        with pytest.raises(BadInput, match=r"s1|ray|127"):
            fly(tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


START = np.array([150.0, 100.0, 0.0, 0.0])


def test_the_moments_of_spread_states_meet_proposition_3() -> None:
    spread = np.random.default_rng(5).uniform(-1, 1, (3000, 4)) * [200, 200, 20, 20]  # excites many directions
    found = measure.filter_moments(load(None, method="mfg"), spread, relative_step=0.02, repeats=150)
    assert found["step_over_bound"] < 1
    assert found["bias"] < 0.2
    assert found["msd_ratio"] == pytest.approx(1.2, abs=0.2)  # the step is too large for the closed form, but fast
    assert found["msd_fall"] < 0.6
    assert 0 < found["learnable"] < 138
    assert 0 < found["followed"] < 138


def test_a_long_flight_counts_the_uavs_that_left_every_bound() -> None:
    assert theory.growth(np.ones(300)) == 1.0
    assert theory.growth(np.linspace(1, 2, 300)) > 1.1
    calm = measure.long_flight(load(None, method="mfg", uavs=4), 30.0)
    assert calm["lost"] == 0
    assert all(math.isfinite(value) for value in calm.values())
    wild = theory.fly_long(load(None, ["learner.mu_h=1e4"], method="mfg", uavs=4), 30.0)
    assert wild.lost == 4
    assert math.isinf(wild.state[-1])


def unforced(plain: Scenario, commands: np.ndarray) -> np.ndarray:
    """The states that the world's own vehicle reaches from START without noise."""
    vehicle, states = PointMass(PointMass.Options(), plain), [START]
    for command in commands:
        states.append(vehicle.step(states[-1], {}, command, np.zeros(2))[0])
    return np.array(states)


def test_the_optimal_flight_obeys_the_dynamics_and_no_disturbed_flight_costs_less() -> None:
    plain, draw = Scenario(), np.random.default_rng(12)
    best = theory.best_flight(plain, START, 300)
    states = unforced(plain, best.accelerations)
    assert states == pytest.approx(best.states, abs=1e-9)
    assert float(theory.flight_cost(plain, states, best.accelerations)) == pytest.approx(best.cost)
    for size in (1e-3, 0.1, 1.0):
        commands = best.accelerations + size * np.cumsum(draw.standard_normal((300, 2)), axis=0) / 17
        assert theory.flight_cost(plain, unforced(plain, commands), commands) > best.cost


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("uavs", [1, 7])
def test_a_swarm_of_one_and_of_an_odd_number_fly(method: str, uavs: int) -> None:
    flown = load(None, method=method, uavs=uavs, duration=3.0)
    summary = Engine(flown, "run", uavs_per_node=2).complete()
    assert (summary["ticks"], summary["uavs"]) == (30, uavs)
    assert (summary["phi_C_distinct"] is None) == (uavs == 1)
    assert not summary["dropped_messages"]


@pytest.mark.parametrize("rows", [1, 4])
def test_models_are_read_and_carried_over_however_the_swarm_is_divided(rows: int) -> None:
    flown = small("mfgfl-hf", "radio.target_snr_db=76", duration=6.0)
    whole, divided = Engine(flown, "run"), Engine(flown, "run", uavs_per_node=rows)
    start = divided.models
    assert start.shape == (6, 246)
    before = whole.complete()
    divided.complete()
    np.testing.assert_array_equal(divided.models, whole.models)
    assert (divided.models != start).any(axis=-1).all()
    memory = {"weights": whole.models}
    again = [Engine(flown, "run", memory=memory, uavs_per_node=each).complete() for each in (rows, None)]
    assert steady(again[0]) == steady(again[1])
    assert again[0]["trajectory_sha256"] != before["trajectory_sha256"]
