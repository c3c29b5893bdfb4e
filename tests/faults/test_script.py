"""Fault scripts: each fault does what it says, and a bad script is refused."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest

from meanflock.cli.command import main
from meanflock.launch.engine import Engine
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind
from tests.faults.by_hand import Recorded
from tests.faults.conftest import Lab, scenario

SCRIPT = Path(__file__).parents[2] / "scenarios" / "faults.toml"
CLEAR = ("federation.fraction=1.0", "radio.target_snr_db=70")  # no outage but those of the script


def flown(*faults: str, method: str = "mfgfl-h", settings: tuple[str, ...] = ()) -> Scenario:
    return scenario(*settings, f"faults=[{', '.join(faults)}]", method=method)


def test_a_killed_uav_falls_silent_and_its_process_goes_home() -> None:
    lab = Lab(flown('{kind="kill", tick=30, uavs=[1, 2]}'), uavs_per_node=1)
    client = lab.client_of("agent-1")
    summary = lab.fly({35: lab.agent})  # a new process may take over
    assert ("killed" in client.stopped.reason, client.stopped.lost) == (True, False)
    assert (summary["lost"], summary["nodes_lost"]) == (1, 0)
    assert lab.record.kinds("lost", "rejoined") == [(30, "lost"), (35, "rejoined")]
    commands = np.concatenate([block.accelerations for block in lab.record.blocks])
    assert not commands[31:, 2].any()
    assert commands[1:31, 2].any(axis=-1).all()
    links = np.concatenate([block.links for block in lab.record.blocks])
    uploads = links[links[:, 3] == FrameKind.UPLOAD]
    assert (uploads[uploads[:, 1] == 2, 0] < 30).all()


def test_a_paused_uav_holds_its_last_command_and_learns_nothing_and_then_goes_on() -> None:
    lab = Lab(flown('{kind="pause", tick=30, duration_s=1.0, uavs=[3]}'))
    agent = lab.client_of("agent-0")._node
    weights_at = {}
    hold = {tick: (lambda tick=tick: weights_at.update({tick: agent.models.copy()})) for tick in (30, 31, 40, 41)}
    lab.fly(hold)
    commands = np.concatenate([block.accelerations for block in lab.record.blocks])
    assert (commands[31:41, 3] == commands[30, 3]).all()
    assert (commands[41, 3] != commands[30, 3]).any()
    assert (commands[31:41, 2] != commands[30, 2]).any()
    np.testing.assert_array_equal(weights_at[40][3], weights_at[30][3])
    assert (weights_at[41][3] != weights_at[40][3]).any()
    assert (weights_at[31][2] != weights_at[30][2]).any()


def outages(lab: Lab, first: int, last: int) -> np.ndarray:
    links = np.concatenate([block.links for block in lab.record.blocks])
    return links[(links[:, 5] == 0) & (links[:, 0] >= first) & (links[:, 0] <= last)]


def test_a_partitioned_uav_loses_each_link_and_no_other_uav_loses_any() -> None:
    lab = Lab(flown('{kind="partition", tick=20, duration_s=2.0, uavs=[2]}', settings=CLEAR))
    summary = lab.fly()
    lost = outages(lab, 0, 1000)
    assert {tuple(link) for link in lost[:, 1:4].tolist()} == {(0, 2, FrameKind.GLOBAL), (2, 0, FrameKind.UPLOAD)}
    assert (lost[:, 4] == lab.world.air._scenario.radio.latency_threshold_slots).all()
    assert (summary["rounds"], summary["radio"]["outages"]) == (5, 2)


def test_a_jam_between_two_uavs_changes_no_other_link() -> None:
    jam = '{kind="jam", tick=0, duration_s=1.0, uavs=[1, 2]}'
    runs = [Lab(case) for case in (flown(jam, method="hjb"), scenario(method="hjb"))]
    for run in runs:
        run.fly()
    jammed, free = (outages(run, 0, 9) for run in runs)
    assert len(free) == 0 or not set(map(tuple, free[:, :3])) & set(map(tuple, jammed[:, :3]))
    assert {tuple(sorted(pair)) for pair in jammed[:, 1:3].tolist()} == {(1, 2)}
    assert len(jammed) == 2 * 9  # in tick 0 the mission plan has said it


def test_a_jammed_area_silences_the_uavs_inside() -> None:
    lab = Lab(flown('{kind="jam", tick=0, duration_s=12.0, centre=[0.0, 0.0], radius_m=500.0}', method="hjb"))
    summary = lab.fly()
    assert summary["radio"]["delivered"] == 0
    away = Lab(flown('{kind="jam", tick=0, duration_s=12.0, centre=[9000.0, 0.0], radius_m=5.0}', method="hjb"))
    assert away.fly()["trajectory_sha256"] == Lab(scenario(method="hjb")).fly()["trajectory_sha256"]


def test_a_gust_accelerates_the_uavs_it_hits_while_it_blows() -> None:
    gust = '{kind="gust", tick=40, duration_s=0.3, acceleration=[2.0, 0.0], uavs=[1]}'
    with_gust, without = Lab(flown(gust, method="offline")), Lab(scenario(method="offline"))
    with_gust.fly()
    without.fly()
    moved, still = (np.concatenate([b.states for b in lab.record.blocks]) for lab in (with_gust, without))
    difference = moved - still
    assert not difference[:41].any()
    assert not difference[:, [0, 2, 3, 4, 5]].any()
    np.testing.assert_allclose(difference[41, 1], [0.02, 0.0, 0.2, 0.0], atol=1e-12)
    kick = 0.2 * (0.99**2 + 0.99 + 1.0)  # what drag has left of three pushes
    np.testing.assert_allclose(difference[[43, 44], 1, 2], [kick, 0.99 * kick], atol=1e-12)


@pytest.mark.parametrize("clusters", [1, 2])
@pytest.mark.parametrize(
    ("silent", "void"),
    [
        ('{kind="kill", tick=30, uavs=[0]}', [2, 3, 4, 5]),
        ('{kind="pause", tick=40, duration_s=0.1, uavs=[0]}', []),  # it uploads nothing, and averages what arrives
        ('{kind="pause", tick=41, duration_s=0.2, uavs=[0]}', [2]),
        ('{kind="pause", tick=35, duration_s=3.0, uavs=[0]}', [2, 3]),
    ],
)
def test_rounds_are_void_while_the_uav_that_averages_is_lost_or_paused(silent, void, clusters) -> None:
    lab = Lab(flown(silent, settings=(f"federation.clusters={clusters}", *CLEAR)))
    summary = lab.fly()
    assert (summary["rounds"], summary["rounds_void"]) == (5 - len(void), len(void))
    texts = [text.split(";")[0] for text in lab.record.texts if "is void" in text]
    assert texts == [f"round {number} is void: UAV 0, which averages, is lost or paused" for number in void]
    broadcasts = [row for block in lab.record.blocks for row in block.links.tolist() if row[3] == FrameKind.GLOBAL]
    assert len(broadcasts) == 5 * (5 - len(void))


def test_a_fault_after_the_end_of_the_flight_is_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = "faults=[{kind='kill', time_s=5.0, uavs=[1]}, {kind='kill', tick=49, uavs=[0]}]"
    flags = ("--in-process", "--uavs", "2", "--duration", "5", "--no-record", "--quiet", "--set", script)
    assert main(["run", *flags, "--out", str(tmp_path / "run")]) == 0
    never = "kill of UAV 1 never happens: it begins at 5 s, and `duration` is 5 s"
    told = capsys.readouterr().err.splitlines()
    assert [line for line in told if "warning" in line] == [f"warning: {never}"]
    faults = Recorded(tmp_path / "run").events("fault")
    assert [(fault["tick"], fault["text"]) for fault in faults] == [(0, never), (49, "kill of UAV 0")]


@functools.cache
def outcome(path: Path, without: int | None) -> tuple[str, str]:
    """Trajectory and link statistics of the paper's scenario under a shipped script, but for one fault of it."""
    faults = [fault for number, fault in enumerate(scenarios.read_faults(path)) if number != without]
    summary = Engine(load(None, ["duration=70"], faults=faults), "script").complete()
    return summary["trajectory_sha256"], json.dumps(summary["radio"], sort_keys=True)


SHIPPED = [
    (path, number, fault.get("harmless", False))
    for path in sorted(SCRIPT.parent.glob("*.toml"))
    if "[[faults]]" in path.read_text(encoding="utf-8")
    for number, fault in enumerate(scenarios.read_faults(path))
]


@pytest.mark.parametrize(("path", "number", "harmless"), SHIPPED, ids=lambda part: getattr(part, "stem", None))
def test_every_fault_of_a_shipped_script_changes_the_flight_or_is_declared_harmless(path, number, harmless) -> None:
    assert (outcome(path, None) == outcome(path, number)) == harmless
