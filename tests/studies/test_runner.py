"""Comparisons and sweeps: flights, values, plug-ins, one recording of several; processes that die and their number."""

import os
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

import meanflock as mf
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording.replay import verify
from meanflock.studies import runner, side_by_side, study
from meanflock.studies.store import Store
from meanflock.studies.swept import Swept
from meanflock.swarm import plugins, state
from meanflock.swarm.errors import EXIT_DONE, BadInput, RunFailed
from meanflock.swarm.scenario import load
from meanflock.swarm.toml import apply
from tests.controller_files import controller_file
from tests.groundstation.recordings import column, scalars
from tests.studies.conftest import QUICK, flown, rows

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.mark.parametrize(
    ("swept", "flags", "wanted"),
    [
        (
            "method=hjb,mfg",
            ("--seeds", "2", "--uavs", "2"),
            [("hjb", 2, 1), ("hjb", 2, 2), ("mfg", 2, 1), ("mfg", 2, 2)],
        ),
        ("seed=5,9", ("--scenario", "mine.toml"), [("mfg", 2, 5), ("mfg", 2, 9)]),
        ("uavs=2,3", ("--methods", "mfg", "--seeds", "1"), [("mfg", 2, 1), ("mfg", 3, 1)]),
    ],
)
def test_method_seed_and_uavs_are_swept_like_any_key(run, tmp_path, swept, flags, wanted) -> None:
    (tmp_path / "mine.toml").write_text('method = "mfg"\nuavs = 2\n')
    code, out, err = run("sweep", swept, *flags, *QUICK)
    assert (code, err) == (EXIT_DONE, "")
    assert [(one["method"], one["uavs"], one["seed"]) for one in flown(tmp_path / "out")] == wanted
    column = swept.partition("=")[0]
    assert column in out
    (label,) = [name for name in rows(tmp_path / "out/sweep.csv")[0] if name.startswith(column)][:1]
    assert [row[label] for row in rows(tmp_path / "out/sweep.csv")] == swept.partition("=")[2].split(",")


@pytest.mark.parametrize(
    ("swept", "label"),
    [("wind.sigma=0.1,0.2", "wind.sigma (m/s/√s)"), ("radio.fading=amplitude,power", "radio.fading")],
)
def test_a_sweep_is_drawn_along_numbers_or_names(run, undrawn, swept: str, label: str) -> None:
    assert run("sweep", swept, "--methods", "mfg", "--seeds", "1", "--uavs", "2", *QUICK)[0] == EXIT_DONE
    assert {(len(figure.axes), figure.axes[-1].get_xlabel()) for figure in undrawn} == {(4, label)}


def test_values_are_words_numbers_lists_or_tables() -> None:
    assert Swept.parse("radio.fading=amplitude, power").values == ("amplitude", "power")
    assert Swept.parse("federation.period=50,100").values == (50, 100)
    lists = Swept.parse("wind.mean=[1, -1],[0.5, 0.5]")
    assert [load(None, [lists.setting(value)]).wind.mean for value in lists.values] == [(1.0, -1.0), (0.5, 0.5)]
    discs = Swept.parse("obstacles=[], [{centre = [30.0, 0.0], radius = 2.0}]")
    assert [len(load(None, [discs.setting(value)]).obstacles) for value in discs.values] == [0, 1]
    words = Swept.parse("""x=["a, b", "it's", "\\n"], [true]""")
    apply(table := {}, words.setting(words.values[0]))
    assert table == {"x": ["a, b", "it's", "\n"]}
    with pytest.raises(BadInput, match="KEY=VALUE"):
        Swept.parse("wind.sigma")


def test_a_changed_plugin_flies_again(tmp_path: Path) -> None:
    """The folder `out` has the flights of an earlier form of the file."""

    def energy(name: str, push: float) -> list[float]:
        controller_file(tmp_path, name, f"return mf.Step(memory, own[:, :2] * {push})")
        out = tmp_path / "out"
        return [
            row["energy_mean_J"]
            for row in mf.compare(
                [name], plugin=tmp_path / f"{name}.py", seeds=2, jobs=1, out=out, uavs=2, duration=2.0
            )
        ]

    first = energy("one", -0.01)
    assert energy("other", -0.02) != first
    assert energy("one", -0.02) == energy("other", -0.02) != first


TICKS = np.arange(41)
SCENARIOS = {name: load(None, method=name, uavs=3, duration=4.0, stop="duration") for name in ("mfgfl-h", "hjb")}


def roots(path: Path) -> set[str]:
    return {chunk.entity_path.split("/")[1] for chunk in RrdReader(path).stream() if chunk.entity_path != "/"}


@pytest.mark.usefixtures("undrawn")
def test_compare_records_every_flight_under_its_own_name_on_one_timeline(run, tmp_path: Path) -> None:
    flags = ("--seeds", "1", "--uavs", "3", "--duration", "4", "--set", "stop=duration", "--jobs", "1", "--quiet")
    code, out, _ = run("compare", *SCENARIOS, "--record", *flags, "--out", "out")
    assert (code, "out/compare.rrd" in out.splitlines()) == (EXIT_DONE, True)
    path = tmp_path / "out/compare.rrd"
    summaries = {summary["method"]: summary for summary in flown(tmp_path / "out")}
    assert verify(path) is None
    assert roots(path) - {"__properties"} == {side_by_side.part_of(name) for name in SCENARIOS}
    for name, scenario in SCENARIOS.items():
        kept, part = Kept(), side_by_side.part_of(name)
        alone = Engine(scenario, "alone", sinks=[kept]).complete()
        assert summaries[name]["trajectory_sha256"] == alone["trajectory_sha256"]
        states = np.concatenate([block.states for block in kept.blocks])
        ticks, positions = column(path, f"{part}/{look.UAVS}", "Points2D:positions")
        np.testing.assert_array_equal(ticks, TICKS)
        np.testing.assert_array_equal(np.array(positions), states[..., state.POSITION].astype(np.float32))
        ticks, drawn = scalars(path, f"{part}/{side_by_side.ENERGY}")
        np.testing.assert_array_equal(ticks, TICKS)
        energy = np.concatenate([block.energy for block in kept.blocks])
        np.testing.assert_allclose(drawn[:, 0], energy.mean(axis=1), rtol=1e-6)
        _, bits = scalars(path, f"{part}/{side_by_side.BITS}")
        assert bits[-1, 0] == pytest.approx(alone["payload_bits"]["total"] / 1e6)


DIES = """marker = Path(__file__).with_suffix(".died")
if os.getpid() != {parent} and self.scenario.seed == 2 and not marker.exists():
    {mark}
    os.kill(os.getpid(), signal.SIGKILL)
return mf.Step(memory, 0.0 * own[:, :2])"""


@pytest.mark.processes
def test_a_flight_whose_process_dies_is_tried_twice(tmp_path: Path) -> None:
    """The second of four flights kills its process, once or always; a repeated study flies the rest."""

    def hashes(mark: str, jobs: int, out: Path) -> list[str]:
        step, top = DIES.format(parent=os.getpid(), mark=mark), "import os, signal\nfrom pathlib import Path"
        file = controller_file(tmp_path, "dying", step, top)
        plugins.load_files([file])
        flights = study.seeded(load(None, method="dying", uavs=2, duration=1.0), 4)
        flown = study.fly_all({"dying": flights}, jobs, lambda *_: None, Store(out))
        return [summary["trajectory_sha256"] for summary in flown["dying"]]

    alone, pool = hashes("pass", 1, tmp_path / "alone"), tmp_path / "pool"
    with pytest.raises(RunFailed, match=rf"died twice.* of 4 runs are kept in {pool}"):
        hashes("pass", 2, pool)
    assert hashes("marker.touch()", 2, pool) == alone
    assert (tmp_path / "dying.died").exists()


def test_negative_numbers_of_jobs_count_down_from_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(4), raising=False)
    assert [runner._number_of(jobs) for jobs in (-9, -4, -2, -1, 1, 7)] == [1, 1, 3, 4, 1, 7]


@pytest.mark.parametrize(
    ("limit", "cores"), [("150000 100000", 2), ("50000 100000", 1), ("max 100000", None), ("", None)]
)
def test_the_cores_of_a_container_bound_the_processes(limit: str, cores: int | None, tmp_path: Path) -> None:
    (tmp_path / "cpu.max").write_text(limit)
    bound = runner.cores(tmp_path / "nowhere")
    assert runner.cores(tmp_path) == (bound if cores is None else min(cores, bound))
