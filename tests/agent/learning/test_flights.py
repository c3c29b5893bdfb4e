"""Flights with a learner: time and energy of training, stragglers, refusals, and what a learner may do wrong."""

import math
import multiprocessing
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.agent.learning import worker
from meanflock.launch.engine import Engine
from meanflock.launch.resume import back
from meanflock.results import inbound
from meanflock.results.series import block_of, rows_of
from meanflock.swarm import plugins
from meanflock.swarm.events import RoundEnded
from meanflock.swarm.plugins import registry
from meanflock.testing import check_learner
from tests.agent.learning.lines import Line, fly, scenario
from tests.faults.dying import dead, flight, steady
from tests.telemetry import Record


@pytest.fixture(autouse=True)
def _unregistered() -> Iterator[None]:
    before = dict(registry.registered)
    yield
    registry.registered.clear()
    registry.registered.update(before)


def uploads(run: mf.Run) -> int:
    """Uploads by radio; that of the leader's UAV, 0, needs none."""
    return int(run.summary["radio"]["traffic"]["uplink"]["transmissions"])


def test_a_line_is_learned_in_flight() -> None:
    run = fly(duration=30)
    assert run.summary["rounds"] == 14
    assert uploads(run) == 14 * 3
    means = [np.mean(row) for row in run.frame()["loss"].to_pylist() if None not in row]
    assert means[-1] < 0.1 < means[15]


BUSY = {"training.fit_s": 1.3, "training.spread": 0.5, "filter.kind": "ecbf", "method": "orca"}


def test_one_agent_with_all_rows_and_agents_of_one_row_have_the_same_bits() -> None:
    flown = scenario(**BUSY)
    summaries = [Engine(flown, "test", uavs_per_node=rows).complete() for rows in (None, 1, 3)]
    for key in ("trajectory_sha256", "models_sha256", "payload_bits", "diagnostics", "energy_compute_J"):
        assert summaries[0][key] == summaries[1][key] == summaries[2][key], key


def test_a_flight_that_died_in_a_training_goes_on_as_the_undisturbed_one(tmp_path: Path) -> None:
    """Checkpoints are of ticks 101 and later; the slowest UAV trains for all of these ticks."""
    flown = scenario(**BUSY, duration=30.0)
    whole = flight(tmp_path / "whole", flown)
    folder = dead(tmp_path / "dead", flown, 155, rows=1)
    again = flight(tmp_path / "dead", flown, kept=back(folder))
    assert steady(again, "dropped_messages") == steady(whole, "dropped_messages")
    assert mf.open(folder).frame().equals(mf.open(tmp_path / "whole" / folder.name).frame())


def test_a_slow_trainer_is_silent_and_uploads_in_the_next_round() -> None:
    """Of 1.5 s at a period of 2 s all are in time; of 2.5 s every other round."""
    assert uploads(fly(duration=20.5, **{"training.fit_s": 1.5})) == 10 * 3
    slow = fly(duration=20.5, **{"training.fit_s": 2.5})
    assert 0 < uploads(slow) < 10 * 3


def test_the_model_of_a_uav_that_is_not_drawn_waits_until_it_is() -> None:
    """Two of four UAVs are drawn in a round. All train at take-off and never again, so each uploads once."""

    class Once(Line):
        name = "once"

        @classmethod
        def takes_part(cls, options: Any, scenario: mf.Scenario, uav: int, config: mf.Fit) -> bool:
            return config.based == 0

    record = Record()
    Engine(scenario(Once, duration=24.0, **{"federation.fraction": 0.5}), "test", sinks=[record]).complete()
    rounds = [event for event in record.events if isinstance(event, RoundEnded)]
    assert len(rounds[0].sent) == 2
    assert sorted(uav for event in rounds for uav in event.sent) == [0, 1, 2, 3]


@pytest.mark.parametrize("trains_again", [True, False])
def test_a_uav_that_hears_no_newer_model_goes_on_from_its_own(trains_again: bool) -> None:
    """All uploads are lost, so there is never a global model."""
    steps: list[int] = []

    class Alone(Line):
        name = "alone"

        def fit(self, model: Any, config: mf.Fit) -> mf.Trained | None:
            assert config.based == 0
            if self.uav == 1:
                steps.append(int(model["steps"]))
            return super().fit(model, config)

    Alone.trains_again = trains_again
    run = fly(Alone, duration=20.5, **{"radio.target_snr_db": 80.0})
    assert (run.summary["rounds"], run.summary["rounds_void"]) == (0, 10)
    assert uploads(run) == (5 if trains_again else 1) * 3  # taken in a round, and trained from the next one on
    assert steps == (list(range(6)) if trains_again else [0])


def test_training_costs_simulated_time_and_energy() -> None:
    """Trainings take 0.5 s + 20 · 0.01 s; there is one at take-off and one after each of four rounds."""
    keys = {"training.fit_s": 0.5, "training.example_s": 0.01, "training.power_W": 3.0}
    run = fly(duration=9.9, **keys)
    assert run.summary["rounds"] == 4
    assert run.summary["energy_compute_J"] == pytest.approx(3.0 * 0.7 * 4 * 5)


def test_what_a_learner_remembers_is_in_the_checkpoint() -> None:

    class Remembers(Line):
        name = "remembers"
        state_bytes = 16
        count = 0

        def fit(self, model: Any, config: mf.Fit) -> mf.Trained | None:
            self.count += 1
            model["weights"] += np.float32(self.count)
            return super().fit(model, config)

        def state(self) -> bytes:
            return b"%d" % self.count

        def load(self, raw: bytes) -> None:
            self.count = int(raw or b"0")

    check_learner(Remembers)
    forgets = type(
        "Forgets", (Remembers,), {"name": "forgets", "state_bytes": 0, "state": Line.state, "load": Line.load}
    )
    with pytest.raises(AssertionError, match="differ after a checkpoint"):
        check_learner(forgets)


# -- refusals before take-off -------------------------------------------------------------------------------------


def test_a_controller_with_a_model_is_refused_with_those_that_can_fly() -> None:
    with pytest.raises(mf.BadInput, match=r"'mfgfl-hf' shares a model of its own.*bvc, cruise.*orca"):
        fly(method="mfgfl-hf")


@pytest.mark.parametrize("draw", [lambda: np.random.normal(), lambda: __import__("random").random()])  # noqa: NPY002
def test_a_controller_that_draws_from_a_global_generator_is_refused(draw: Any) -> None:
    class Draws(mf.Controller):
        name = "draws"

        def step(self, memory: Any, tick: int, own: Any, received: Any) -> mf.Step:
            return mf.Step(memory, np.full((len(own), 2), draw()))

    with pytest.raises(mf.BadInput, match=r"'draws' draws from a global random generator.*mf\.seeds\.generator"):
        fly(method=Draws)


def test_a_rule_that_draws_from_a_global_generator_is_refused() -> None:
    class Shuffles(mf.Aggregator):
        name = "shuffles"

        def step(self, state: Any, uploads: Any) -> Any:
            return state, uploads.models[np.random.permutation(len(uploads.models))[0]]  # noqa: NPY002

    plugins.register(Shuffles)
    with pytest.raises(mf.BadInput, match="rule 'shuffles' draws from a global random generator"):
        fly(**{"federation.aggregation": "shuffles"})


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({"w": np.array([np.nan])}, "`initial` has a number that is not finite"),
        ({"w": np.array([1e39])}, "`initial` has a number that is not finite, or"),
        ({"w": np.array(["a"])}, "'w' is of <U1"),
        ({"w": np.zeros(10_000_001, np.float32)}, "its model has 10000001 numbers, and at most 10000000 are sent"),
    ],
)
def test_a_first_model_that_cannot_be_sent_is_refused(initial: Any, message: str) -> None:
    wrong = type("Wrong", (Line,), {"name": "wrong", "initial": classmethod(lambda *_: initial)})
    with pytest.raises(mf.BadInput, match=f"learner 'wrong': .*{message}|{message}"):
        fly(wrong)


def test_models_beyond_memory_are_refused() -> None:
    large = {"w": np.zeros(1_000_000, np.float32)}
    big = type("Big", (Line,), {"name": "big", "initial": classmethod(lambda *_: large)})
    with pytest.raises(mf.BadInput, match=r"memory: [\d.]+ GiB for 2000 UAVs.*fewer UAVs"):
        fly(big, uavs=2000, **{"federation.fragment": 0, "radio.model": "ideal"})


def test_keys_of_a_training_have_no_effect_without_a_learner() -> None:
    with pytest.raises(mf.BadInput, match=r"`training.fit_s` has no effect without `training.learner`"):
        mf.Scenario(**{"training.fit_s": 1.0})


# -- what a learner may do wrong ------------------------------------------------------------------------------------


def wrong(**methods: Any) -> type[mf.Learner]:
    return type("Wrong", (Line,), {"name": "wrong"} | methods)


def told(run: mf.Run) -> str:
    return "\n".join(event["text"] for event in run.events if event["kind"] in ("agent", "training"))


def of_uav_1(change: Any) -> Any:
    """The method `fit` of a line, which UAV 1 changes."""

    def fit(self: Any, model: Any, config: mf.Fit) -> Any:
        trained = Line.fit(self, model, config)
        return change(trained) if self.uav == 1 else trained

    return fit


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda t: mf.Trained(t.model | {"weights": np.zeros((3, 1), np.float32)}, 1.0), "'weights' has shape (3, 1)"),
        (lambda t: mf.Trained(t.model, 0.0), "`examples` has 0"),
        (lambda t: mf.Trained(t.model, 1.0, None), "`metrics` of `fit`: a NoneType; expected a dict of numbers"),
        (lambda t: mf.Trained(t.model, float("nan")), "`examples` has nan"),
        (lambda t: mf.Trained(t.model, 1.0, note=b"too long"), "its note is 8 bytes; `note_bytes` declares 0 bytes"),
        (lambda t: t.model, "`fit` returns a dict; expected mf.Trained(model, examples) or None"),
        (lambda t: 1 / 0, "ZeroDivisionError"),
        (lambda t: exec("raise SystemExit(3)"), "SystemExit: 3"),
        (lambda t: __import__("os").fork(), "a learner may start no process"),
        (lambda t: __import__("subprocess").run(["true"]), "a learner may start no process"),
        (lambda t: multiprocessing.get_context("spawn").Process().start(), "a learner may start no process"),
        (lambda t: multiprocessing.get_context("forkserver").Process().start(), "a learner may start no process"),
    ],
)
def test_a_learner_that_fails_loses_its_uav_and_no_other(change: Any, text: str) -> None:
    run = fly(wrong(fit=of_uav_1(change)), duration=4)
    assert run.summary["lost"] == 1
    assert text in told(run)
    assert "learner 'wrong'" in told(run)
    assert "UAV 1" in told(run)


@pytest.mark.parametrize(("run", "lost"), [("subprocess.run(['true'])", 0), ("os.fork()", 1)])
def test_a_learner_that_declares_programs_runs_them_and_may_not_fork(run: str, lost: int) -> None:
    learner = wrong(fit=of_uav_1(lambda trained: exec(f"import os, subprocess; {run}") or trained), runs_programs=True)
    assert fly(learner, duration=4).summary["lost"] == lost


def test_a_learner_that_cannot_be_made_is_named() -> None:
    def init(self: Any, options: Any, scenario: mf.Scenario, uav: int) -> None:
        raise OSError("no such data")

    with pytest.raises(
        mf.BadInput, match=r"failed in `init` with UAV 0: RuntimeError: learner 'wrong': OSError: no such"
    ):
        fly(wrong(__init__=init))


BEYOND = "has 1e+38, beyond what the radio's floats can say"


@pytest.mark.parametrize(("number", "text"), [(np.nan, "is not finite"), (np.inf, "is not finite"), (1e38, BEYOND)])
def test_a_model_that_cannot_be_sent_is_silent_and_told(number: float, text: str) -> None:
    spoil = of_uav_1(lambda t: mf.Trained(t.model | {"weights": np.full(3, number, np.float32)}, 1.0))
    run = fly(wrong(fit=spoil), duration=5)
    assert run.summary["lost"] == 0
    assert uploads(run) == 2 * 2
    assert f"learner 'wrong' of UAV 1: its trained model {text}; it uploads no model" in told(run)
    failed = [event["fields"]["uav"] for event in run.events if event["event"] == "fit-failed"]
    assert failed == [1] * len(failed) != []


def test_a_lost_uav_trains_no_more() -> None:
    calls: list[int] = []

    def fit(self: Any, model: Any, config: mf.Fit) -> Any:
        calls.append(self.uav)
        return 1 / 0 if self.uav == 1 else Line.fit(self, model, config)

    assert fly(wrong(fit=fit), duration=4.5).summary["rounds"] == 2
    assert sorted(calls) == [0, 0, 0, 1, 2, 2, 2, 3, 3, 3]


def test_a_learner_may_take_no_part() -> None:
    run = fly(wrong(fit=of_uav_1(lambda t: None)), duration=5)
    assert (run.summary["lost"], uploads(run)) == (0, 2 * 2)


def test_threads_that_a_learner_leaves_are_told() -> None:
    stop = threading.Event()

    def leave(trained: mf.Trained) -> mf.Trained:
        threading.Thread(target=stop.wait, daemon=True).start()
        return trained

    try:
        assert "learner 'wrong' of UAV 1 left 1 thread running" in told(fly(wrong(fit=of_uav_1(leave)), duration=1))
    finally:
        stop.set()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_process_that_a_thread_of_a_learner_starts_later_is_refused_and_loses_its_uav() -> None:
    go, threads = threading.Event(), list[threading.Thread]()

    def start() -> None:
        go.wait()
        os.fork()

    def fit(self: Any, model: Any, config: mf.Fit) -> Any:
        if self.uav == 1 and not threads:
            threads.append(threading.Thread(target=start))
            threads[0].start()
        if self.uav == 0 and config.number == 2:
            go.set()
            threads[0].join()
        return Line.fit(self, model, config)

    run = fly(wrong(fit=fit), duration=6)
    assert run.summary["lost"] == 1
    assert "a learner may start no process" in told(run)


def test_a_learner_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker, "FIT_S", 0.2)

    def hang(_: Any) -> None:
        while True:
            time.sleep(0.01)

    run = fly(wrong(fit=of_uav_1(hang)), duration=4)
    assert run.summary["lost"] == 1
    assert "it has trained for 0.2 s of wall time" in told(run)
    assert uploads(run) == 1 * 2


def test_the_users_generators_are_untouched() -> None:
    np.random.seed(5)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # type: ignore[index,union-attr]  # noqa: NPY002
    fly(duration=3)
    assert (np.random.get_state()[1] == before).all()  # type: ignore[index]  # noqa: NPY002


def test_a_thread_that_others_start_meanwhile_is_none_of_the_learner() -> None:
    asked, begun, over = threading.Event(), threading.Event(), threading.Event()
    other = threading.Thread(target=over.wait)

    def start_another() -> None:
        asked.wait()
        other.start()
        begun.set()
        over.wait()

    class Watched(Line):
        name = "watched"

        def fit(self, model: Any, config: mf.Fit) -> mf.Trained | None:
            asked.set()
            begun.wait()
            return super().fit(model, config)

    starter = threading.Thread(target=start_another)
    starter.start()
    try:
        run = fly(Watched, duration=1.0)
        assert other.is_alive()
    finally:
        asked.set()
        over.set()
        starter.join()
        other.join()
    assert not [event for event in run.events if "running" in event["text"]]


@pytest.mark.parametrize("metrics", [{"loss": math.nan}, {}])
def test_a_uav_whose_training_gave_not_all_metrics_counts_in_no_mean(metrics: dict[str, float]) -> None:
    class Unmeasured(Line):
        """UAV 1 measures nothing from its third training on."""

        name = "unmeasured"

        def fit(self, model: Any, config: mf.Fit) -> mf.Trained | None:
            trained = super().fit(model, config)
            assert trained is not None
            return msgspec.structs.replace(
                trained, metrics=metrics if self.uav == 1 and config.number > 2 else trained.metrics
            )

    run = fly(Unmeasured)
    rows, ticks = run.rounds().to_pylist(), run.frame().to_pylist()
    assert len(rows) > 3
    for row in rows:
        frame = ticks[row["tick"]]
        counted = [uav for uav, count in enumerate(frame["examples"]) if count]
        assert counted == ([0, 1, 2, 3] if row["round"] <= 2 else [0, 2, 3])
        assert row["mean_loss"] == pytest.approx(np.mean([frame["loss"][uav] for uav in counted]))


def test_a_uav_that_has_not_trained_counts_in_no_mean() -> None:
    """A round of which no UAV has finished a training reaches no bound; one of which some have has their mean."""
    slow = {"training.fit_s": 3.0, "training.spread": 0.8, "method": "orca"}
    run = fly(**slow)
    rows, ticks = run.rounds().to_pylist(), run.frame().to_pylist()
    assert any(0 < sum(count is not None for count in ticks[row["tick"]]["examples"]) < 4 for row in rows)
    for row in rows:
        frame = ticks[row["tick"]]
        losses = [loss for loss, count in zip(frame["loss"], frame["examples"], strict=True) if count]
        assert row["mean_loss"] == (pytest.approx(np.mean(losses)) if losses else None)
        assert row["mean_examples"] == (20.0 if losses else None)
    block = inbound.check(block_of(run.frame(), 0), 4)
    assert rows_of(block, run.scenario.dt)["loss"].equals(run.frame()["loss"].combine_chunks())
    assert {None} == {*ticks[0]["loss"], *ticks[1]["examples"]}
    assert not any(None in tick["training"] for tick in ticks)
    for name in ("loss", "examples"):
        known = [value for tick in ticks for value in tick[name] if value is not None]
        assert 0.0 not in known
        assert run.summary["diagnostics_mean"][name] == pytest.approx(np.mean(known), rel=1e-6)  # all are on the way
    bound = max(row["mean_loss"] or 0.0 for row in rows)
    ended = fly(**slow, until=f"loss<={bound!r}")
    assert ended.summary["until"]["round"] == next(row["round"] for row in rows if row["mean_loss"] is not None)
