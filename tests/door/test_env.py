"""Environments for reinforcement learning, and the controller that flies what they train."""

import io
import re
import runpy
import zipfile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import meanflock as mf
from meanflock import env
from meanflock.agent.controllers.policy.network import TRAINED, read
from meanflock.agent.controllers.policy.perception import width
from meanflock.agent.node import Agent
from meanflock.studies.leaderboard import rows
from meanflock.swarm.scenario import encode
from meanflock.swarm.wire.messages import Welcome
from tests.sources import ROOT

SMALL: dict[str, Any] = {"uavs": 5, "duration": 10.5}  # beyond the hundredth tick
NEIGHBOURS, MESSAGE = 3, 2


@pytest.fixture
def policy(tmp_path: Path) -> env.Policy:
    return _policy(tmp_path, 2)


def _policy(tmp_path: Path, dimensions: int) -> env.Policy:
    """A policy with a hidden layer and messages, of random numbers."""
    rng = np.random.default_rng(5)
    inputs = width(NEIGHBOURS, MESSAGE, dimensions)
    shapes = ((inputs, 7), (7, dimensions + MESSAGE))
    layers = [(0.3 * rng.standard_normal(shape), rng.standard_normal(shape[1])) for shape in shapes]
    return env.save_policy(
        tmp_path / "policy.npz", layers, neighbours=NEIGHBOURS, message=MESSAGE, scale=np.full(inputs, 9.0)
    )


def test_the_judges_of_pettingzoo_find_nothing() -> None:
    parallel_api_test(env.parallel_env("paper", message=1, **SMALL), 100)
    parallel_seed_test(lambda: env.parallel_env("paper", **SMALL))


@pytest.mark.parametrize(("dimensions", "inputs"), [(2, 28), (3, 36)])
def test_a_policy_flies_the_same_bits_in_every_environment(dimensions: int, inputs: int, tmp_path: Path) -> None:
    policy, keys = _policy(tmp_path, dimensions), SMALL | {"space.dimensions": dimensions}
    flock = env.parallel_env("paper", neighbours=NEIGHBOURS, message=MESSAGE, seed=7, **keys)
    observations, _ = flock.reset()
    while flock.agents:
        actions = policy(np.stack([*observations.values()]))
        observations, *_ = flock.step(dict(zip(observations, actions, strict=True)))
    flights = env.vector_env("paper", flights=2, neighbours=NEIGHBOURS, message=MESSAGE, seed=7, **keys)
    rows, _ = flights.reset()
    assert rows.shape == (flights.num_envs, width(NEIGHBOURS, MESSAGE, dimensions)) == (10, inputs)
    while not flights.summaries:
        rows, _, terminated, truncated, infos = flights.step(policy(rows))
    assert (terminated | truncated).all()
    np.testing.assert_array_equal(terminated, infos["arrived"])

    scenario = mf.Scenario.load("paper", seed=7, **keys, **policy.keys)
    summaries = [flock.finish().summary, flights.summaries[0], mf.fly(scenario).summary]
    assert len({summary["trajectory_sha256"] for summary in summaries}) == 1
    assert all(summary["payload_bits"] == summaries[0]["payload_bits"] for summary in summaries)
    silent = mf.fly("paper", method="policy", seed=7, **keys).summary
    assert sum(silent["payload_bits"].values()) < sum(summaries[0]["payload_bits"].values())
    rows, rewards, terminated, truncated, _ = flights.step(policy(rows))  # the next flights begin
    assert not np.concatenate([rewards, terminated, truncated]).any()
    assert [episode.tick for episode in flights._episodes] == [0, 0]


def test_what_a_uav_observes_came_by_radio() -> None:
    flock = env.parallel_env("paper", neighbours=6, message=1, uavs=3, seed=2)
    observations, _ = flock.reset()
    first = observations["uav_0"].reshape(-1)
    np.testing.assert_allclose(first[:4], mf.mission.starts(mf.Scenario(uavs=3))[0])
    others = first[4:].reshape(6, 7)
    np.testing.assert_array_equal(others[:, 5], [1, 1, 0, 0, 0, 0])
    for tick in range(1, 4):
        observations, *_ = flock.step({agent: np.array([0, 0, 0.5]) for agent in flock.agents})
        others = observations["uav_0"][4:].reshape(6, 7)
        assert (others[:2, 4] <= tick * 0.1 + 1e-9).all()
        assert not others[2:].any()
    np.testing.assert_allclose(others[:2, 6], 0.5)  # the messages


def test_rewards_are_the_sum_of_their_weighted_terms() -> None:
    flock = env.parallel_env("paper", reward={"time": 0.0, "loss": -7.0}, **SMALL)
    flock.reset(seed=1)
    command = {agent: np.zeros(2) for agent in flock.agents}
    command["uav_1"] = np.array([np.nan, 0.0])
    command["uav_2"] = np.array([2.0, 0.0])
    _, rewards, terminated, _, infos = flock.step(command)
    weights = env.WEIGHTS | {"time": 0.0, "loss": -7.0}
    for agent, info in infos.items():
        expected = np.nansum([weights[name] * term for name, term in zip(env.TERMS, info["terms"], strict=True)])
        assert rewards[agent] == pytest.approx(expected)
    assert infos["uav_2"]["terms"][env.TERMS.index("effort")] == pytest.approx(0.4)
    assert infos["uav_1"]["terms"][env.TERMS.index("loss")] == 1.0
    assert [agent for agent, ended in terminated.items() if ended] == ["uav_1"]
    assert infos["uav_1"]["lost"]
    assert "uav_1" not in flock.agents
    assert len(flock.agents) == 4
    _, rewards, *_ = flock.step({agent: np.zeros(2) for agent in flock.agents})
    assert "uav_1" not in rewards


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda actions: actions.pop("uav_3"), "no action of uav_3"),
        (lambda actions: actions.update(uav_9=np.zeros(2)), "'uav_9' is no agent"),
        (lambda actions: actions.update(uav_0=np.zeros(3)), r"uav_0 is float64 \(3,\)"),
        (lambda actions: actions.update(uav_0=np.array(["a", "b"])), "uav_0 is <U1"),
    ],
)
def test_actions_that_do_not_fit_fly_nothing(change: Any, says: str) -> None:
    flock = env.parallel_env("paper", **SMALL)
    with pytest.raises(mf.BadInput, match="call reset first"):
        flock.step({})
    flock.reset()
    actions = {agent: np.zeros(2) for agent in flock.agents}
    change(actions)
    with pytest.raises(mf.BadInput, match=says):
        flock.step(actions)
    flock.step({agent: np.zeros(2) for agent in flock.agents})
    summary = flock.finish().summary
    assert (summary["ticks"], summary["lost"]) == (1, 0)


def test_commands_of_another_shape_fly_nothing() -> None:
    flights = env.vector_env("paper", flights=1, **SMALL)
    flights.reset(seed=3)
    with pytest.raises(mf.BadInput, match="nothing was flown"):
        flights.step(np.zeros((4, 2)))


def test_without_the_extra_the_error_has_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("meanflock.swarm.errors._is_there", lambda library: False)
    for module, make in (("parallel", env.parallel_env), ("vector", env.vector_env)):
        monkeypatch.setitem(__import__("sys").modules, "gymnasium.spaces", None)
        monkeypatch.delitem(__import__("sys").modules, f"meanflock.env.{module}", raising=False)
        with pytest.raises(mf.BadInput, match=r"gymnasium is not installed.*pip install 'meanflock\[rl\]'"):
            make("paper")


# -- the file of a policy ----------------------------------------------------------------------------------------------


def test_a_scenario_records_the_hash_and_a_node_with_another_file_is_refused(policy: env.Policy, tmp_path) -> None:
    scenario = mf.Scenario(method="policy", controller={"file": str(policy.path)}, **SMALL)
    resolved = scenario.resolved()
    assert resolved.controller["sha256"] == policy.sha256
    assert scenario.sha256() == resolved.sha256()
    plan = mf.mission.starts(scenario).astype(np.float32)
    Agent(Welcome(0, "agent-0", (0,), 0, encode(resolved), plan))
    policy.path.write_bytes(TRAINED[2].read_bytes())
    with pytest.raises(mf.BadInput, match=f"the scenario wants {policy.sha256}; copy the same file"):
        Agent(Welcome(0, "agent-0", (0,), 0, encode(resolved), plan))
    with pytest.raises(mf.BadInput, match="copy the same file"):
        mf.fly(resolved)
    policy.path.unlink()
    again = mf.Scenario(**msgspec.to_builtins(resolved))  # of a run that is only looked at
    assert again.sha256() == scenario.sha256()


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_installed_policy_is_recorded_flies_and_is_that_of_the_example(dimensions: int, tmp_path: Path) -> None:
    installed = env.policy(TRAINED[dimensions])
    assert installed.dimensions == dimensions
    keys: dict[str, Any] = {"space.dimensions": dimensions}
    assert mf.Scenario.load("paper", method="policy", **keys).resolved().controller == {"sha256": installed.sha256}
    with pytest.raises(mf.BadInput, match="install the same meanflock on every host"):
        mf.fly("paper", method="policy", **{"controller.sha256": "0" * 64}, **keys)
    train = runpy.run_path(str(ROOT / "examples" / "train.py"))
    numbers = np.array([10.0, 12.0, 1.0, -0.1, 0.1, 2.0, 1.5, 0.5, 0.2])
    files = [train["saved"](tmp_path / name, numbers, dimensions).path.read_bytes() for name in ("a.npz", "b.npz")]
    assert files[0] == files[1]
    with np.load(TRAINED[dimensions]) as ours, np.load(tmp_path / "a.npz") as theirs:
        assert [(name, array.shape) for name, array in ours.items()] == [(n, a.shape) for n, a in theirs.items()]
    for row in rows.chosen(["policy", "policy-ecbf"]):
        run = mf.fly(row.scenario({"uavs": 9, "space": {"dimensions": dimensions}}, 1001, "a mission"))
        assert (run.summary["arrived"], run.summary["collisions"]) == (9, 0), row.name


def test_a_policy_of_the_plane_is_refused_in_space_and_the_other_way_round() -> None:
    for there, here in ((2, 3), (3, 2)):
        keys = {"controller.file": str(TRAINED[there]), "space.dimensions": here}
        with pytest.raises(
            mf.BadInput, match=rf"flies in {there} dimensions, and `space\.dimensions` is {here}; train"
        ):
            mf.fly("paper", method="policy", uavs=3, **keys)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"version": 2}, "version 2; this meanflock reads version 1"),
        ({"scale": np.ones(3)}, "scale is float64 (3,); expected float64 (28,)"),
        ({"scale": np.zeros(28)}, "greater than 0"),
        ({"weights_0": np.ones((28, 7), np.float32)}, "weights_0 is float32"),
        ({"biases_1": np.full(4, np.nan)}, "biases_1 is not finite"),
        ({"biases_1": np.zeros(6)}, "the last layer has outputs (6,); expected accelerations of 2 or 3 numbers"),
        ({"biases_1": np.zeros(5)}, "weights_0 is float64 (28, 7); expected float64 (36, 7)"),
        ({"extra": np.zeros(1), "more": np.zeros(1)}, "it has biases_0"),
        ({"weights_0": np.array([[{}]], dtype=object)}, "Object arrays cannot be loaded"),
        ({"neighbours": 1.0}, "must be integers"),
    ],
)
def test_another_file_is_refused_by_one_line(policy: env.Policy, changed: dict[str, Any], says: str) -> None:
    with np.load(policy.path) as arrays:
        content = {**arrays} | changed
    np.savez(policy.path, **content)
    with pytest.raises(mf.BadInput, match=re.escape(says)) as caught:
        mf.fly("paper", method="policy", **{"controller.file": str(policy.path)})
    assert len(str(caught.value).splitlines()) == 1


def test_damaged_large_and_missing_files_are_refused(policy: env.Policy) -> None:
    whole = policy.path.read_bytes()
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scale.npy", bytes(2**25))
    for content in (b"", b"PK", whole[:200], whole[:-30], bomb.getvalue(), np.zeros(3).tobytes()):
        policy.path.write_bytes(content)
        with pytest.raises(mf.BadInput, match=r"policy .*policy\.npz: "):
            read(policy.path)
    policy.path.unlink()
    with pytest.raises(mf.BadInput, match="no such file"):
        env.policy(policy.path)


@pytest.mark.parametrize("flights", [1, 4])
def test_an_environment_that_does_not_fit_into_memory_is_refused_with_the_largest_that_fits(
    monkeypatch: pytest.MonkeyPatch, flights: int
) -> None:
    def make(uavs: int) -> Any:
        keys: dict[str, Any] = {"uavs": uavs, "message": 2}
        return env.parallel_env("massive", **keys) if flights == 1 else env.vector_env("massive", flights=4, **keys)

    monkeypatch.setattr("meanflock.launch.memory.available_mb", lambda: (600, "available"))
    with pytest.raises(mf.BadInput, match=r"^memory: \d,\d{3}\.\d GiB for .* 0\.6 GiB available;") as caught:
        make(100_000)
    assert ("fewer flights" in str(caught.value)) == (flights > 1)
    most = int(str(caught.value).split("uavs=")[1].split()[0])
    assert 100 < most < 2000
    make(most)
    with pytest.raises(mf.BadInput, match=f"uavs={most} at most"):
        make(most + 10)
    monkeypatch.setattr("meanflock.launch.memory.available_mb", lambda: (0, "available"))
    make(25)  # never refused
