"""What other libraries expect of an environment: episodes, seeds, the state, whole numbers of any type, and errors."""

import copy
import re
import zipfile
from pathlib import Path
from typing import Any

import gymnasium.wrappers.vector as wrappers
import numpy as np
import pytest

import meanflock as mf
from meanflock import env

TINY: dict[str, Any] = {"neighbours": 1, "uavs": 3, "duration": 1.0}  # 10 ticks
STILL = np.zeros((3, 2))


def seeds(flights: Any) -> list[int]:
    """The seeds of the flights of a vector environment whose rows are three UAVs each."""
    return [episode.scenario.seed for episode in flights._episodes]


# -- episodes ----------------------------------------------------------------------------------------------------------


def test_a_lost_row_is_terminated_once_and_then_inactive() -> None:
    flights = env.vector_env("paper", flights=1, seed=1, **TINY)
    recorded = wrappers.RecordEpisodeStatistics(flights)
    recorded.reset()
    lengths, masks = list[int](), list[Any]()
    for tick in range(11):
        actions = STILL.copy()
        actions[1] = np.nan if tick == 5 else 0.0  # UAV 1 is lost
        _, rewards, terminated, truncated, infos = recorded.step(actions)
        masks.append((terminated.tolist(), truncated.tolist(), infos["active"].tolist()))
        assert not rewards[~infos["active"]].any()
        if "episode" in infos:
            lengths += infos["episode"]["l"][infos["_episode"]].tolist()
    none, everyone, others = [False] * 3, [True] * 3, [True, False, True]
    assert lengths == [6, 10, 10]
    assert masks == [
        *[(none, none, everyone)] * 5,
        ([False, True, False], none, everyone),
        *[(none, none, others)] * 3,
        (none, others, others),
        (none, none, none),  # the next flight begins
    ]


def test_the_last_hundred_summaries_stay_and_one_of_each_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("meanflock.env.vector._SUMMARIES", 3)
    for flights, rounds, stay in ((1, 4, 3), (4, 2, 4)):
        many = env.vector_env("paper", flights=flights, seed=1, neighbours=1, uavs=1, duration=0.1)
        many.reset()
        for _ in range(2 * rounds):  # a tick, and a step in which the next flights begin
            many.step(np.zeros((flights, 2)))
        assert [summary["seed"] for summary in many.summaries] == list(range(1, rounds * flights + 1))[-stay:]


# -- seeds -------------------------------------------------------------------------------------------------------------


def test_without_a_seed_each_copy_flies_a_flight_of_its_own_and_says_which() -> None:
    flock = env.parallel_env("paper", **TINY)
    told = set()
    for one in (flock, copy.deepcopy(flock)):
        for _ in range(2):
            first, infos = one.reset()
            (seed,) = {info["seed"] for info in infos.values()}
            again, _ = env.parallel_env("paper", seed=seed, **TINY).reset()
            np.testing.assert_array_equal(first["uav_0"], again["uav_0"])
            assert one.finish().scenario.seed == seed == one.np_random_seed
            told.add(seed)
    assert len(told) == 4
    flights = env.vector_env("paper", flights=2, **TINY)
    for one in (flights, copy.deepcopy(flights)):
        _, infos = one.reset()
        assert infos["seed"].tolist() == np.repeat(seeds(one), 3).tolist()
        assert one.np_random_seed == seeds(one)[0]
        told.update(seeds(one))
    assert len(told) == 8


def test_a_seed_is_followed_by_the_next_ones(tmp_path: Path) -> None:
    flock = env.parallel_env("paper", seed=5, **TINY)
    found = [next(iter(flock.reset(seed=seed)[1].values()))["seed"] for seed in (None, None, np.int64(9), None)]
    assert found == [5, 6, 9, 10]
    file = mf.Scenario(seed=8).save(tmp_path / "mine.toml")
    for mission in (mf.Scenario(seed=8), file, str(file)):
        assert next(iter(env.parallel_env(mission, **TINY).reset()[1].values()))["seed"] == 8


def test_a_list_has_a_seed_for_each_flight() -> None:
    flights = env.vector_env("paper", flights=2, **TINY)
    for given in ([7, 3], (np.int64(7), 3), np.array([7, 3])):
        rows, infos = flights.reset(seed=given)
        assert infos["seed"].tolist() == [7, 7, 7, 3, 3, 3]
    alone, _ = env.vector_env("paper", flights=1, **TINY).reset(seed=3)
    np.testing.assert_array_equal(rows[3:], alone)
    flights.reset()
    assert seeds(flights) == [8, 9]
    flights.reset(seed=[None, 4])
    assert seeds(flights)[0] != seeds(flights)[1] == 4


def test_reset_seeds_a_generator() -> None:
    for make in (env.parallel_env, env.vector_env):
        one = make("paper", **TINY)
        one.reset(seed=3)
        numbers = one.np_random.random(4)
        one.np_random.random()
        one.reset(seed=3)
        np.testing.assert_array_equal(one.np_random.random(4), numbers)
        assert one.np_random_seed == 3


# -- the state, and arguments ------------------------------------------------------------------------------------------


def test_the_state_is_that_of_all_uavs() -> None:
    flock = env.parallel_env("paper", seed=1, **TINY)
    with pytest.raises(mf.BadInput, match="call reset first"):
        flock.state()
    flock.reset()
    flock.step({"uav_0": np.zeros(2), "uav_1": np.full(2, np.nan), "uav_2": np.zeros(2)})
    state = flock.state()
    assert flock.agents == ["uav_0", "uav_2"]
    assert flock.state_space.contains(state)
    state[:] = 0.0  # a copy
    np.testing.assert_array_equal(flock.state(), flock.finish().states[-1])


def test_whole_numbers_may_be_of_numpy(tmp_path: Path) -> None:
    one, two = np.uint8(1), np.int64(2)
    flights = env.vector_env("paper", flights=two, neighbours=one, message=two, acceleration=np.float32(2), uavs=two)
    assert flights.reset(seed=two)[0].shape == (4, 12)
    flock = env.parallel_env("paper", neighbours=np.array(1), message=one, uavs=two)
    assert flock.reset(seed=np.uint64(2))[0]["uav_0"].shape == (11,)
    saved = env.save_policy(tmp_path / "p.npz", [(np.zeros((12, 4)), np.zeros(4))], neighbours=one, message=np.uint8(2))
    assert (saved.neighbours, saved.message) == (1, 2)


WEIGHTS, BIASES = np.zeros((10, 2)), np.zeros(2)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda make: make(5, **TINY), "scenario: 5; give the name"),
        (lambda make: make("obstacle", **TINY), "windy; did you mean 'obstacles'?"),
        (lambda make: make("paper", reward=5, **TINY), "reward: 5; give a dict"),
        (lambda make: make("paper", reward="time", **TINY), "reward: 'time'; give a dict"),
        (lambda make: make("paper", reward={5: 1.0}, **TINY), "no term 5"),
        (lambda make: make("paper", acceleration=[1.0], **TINY), "acceleration: [1.0]"),
        (lambda make: make("paper", seed=-1, **TINY), "seed: -1"),
        (lambda make: make("paper", **TINY | {"neighbours": "4"}), "neighbours: '4'"),
        (lambda make: make("paper", **TINY | {"neighbours": True}), "neighbours: True"),
        (lambda make: make("paper", **TINY).reset(seed="x"), "seed: 'x'"),
        (lambda make: make("paper", **TINY).reset(seed=1.5), "seed: 1.5"),
        (lambda make: make("paper", **TINY).reset(seed=2**63), "seed: 9223372036854775808"),
        (lambda make: make("paper", **TINY).reset(seed=[1] * 9), "9 seeds; give one for each of the"),
    ],
)
def test_a_wrong_argument_of_an_environment_is_bad_input(call: Any, says: str) -> None:
    for make in (env.parallel_env, env.vector_env):
        with pytest.raises(mf.BadInput, match=re.escape(says)):
            call(make)


def test_actions_of_another_kind_are_bad_input() -> None:
    flock, flights = env.parallel_env("paper", **TINY), env.vector_env("paper", flights=1, **TINY)
    flock.reset(), flights.reset()
    for actions in (None, STILL, {"uav_0": [1, [2]], "uav_1": STILL[0], "uav_2": STILL[0]}):
        with pytest.raises(mf.BadInput, match="nothing was flown"):
            flock.step(actions)  # type: ignore[arg-type]
    for table in (None, "x", [[1], [2, 3]], STILL * 1j):
        with pytest.raises(mf.BadInput, match="nothing was flown"):
            flights.step(table)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"file": 5}, "5 is no path of a file"),
        ({"file": "a\0.npz"}, "no path contains NUL"),
        ({"layers": [(WEIGHTS[1:], BIASES)]}, "policy: weights_0 is float64"),
        ({"layers": 5}, "give pairs of arrays"),
        ({"layers": [(WEIGHTS * 1j, BIASES)]}, "give pairs of arrays"),
        ({"layers": [([[1], [1, 2]], BIASES)]}, "give pairs of arrays"),
        ({"neighbours": "1"}, "neighbours: '1'"),
        ({"neighbours": -1}, "neighbours: -1"),
        ({"message": None}, "message: None"),
        ({"scale": "x"}, "give pairs of arrays"),
        ({"acceleration": None}, "give pairs of arrays"),
    ],
)
def test_a_wrong_argument_of_a_policy_is_bad_input(changed: dict[str, Any], says: str, tmp_path: Path) -> None:
    given = {"file": tmp_path / "p.npz", "layers": [(WEIGHTS, BIASES)], "neighbours": 1} | changed
    with pytest.raises(mf.BadInput, match=re.escape(says)):
        env.save_policy(**given)


def test_observations_of_another_shape_are_bad_input(tmp_path: Path) -> None:
    policy = env.save_policy(tmp_path / "p.npz", [(WEIGHTS, BIASES)], neighbours=1)
    assert policy(np.zeros((0, 10))).shape == (0, 2)
    for observations in (None, np.zeros(10), np.zeros((3, 9)), np.zeros((3, 10)) * 1j, [["a"] * 10]):
        with pytest.raises(mf.BadInput, match="policy: "):
            policy(observations)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "header", ["{'descr': (", "{'descr': '<f8', 'fortran_order': False, 'shape': (9" + "9" * 20 + ",)}"]
)
def test_a_policy_file_whose_arrays_are_damaged_is_bad_input(header: str, tmp_path: Path) -> None:
    policy = env.save_policy(tmp_path / "p.npz", [(WEIGHTS, BIASES)], neighbours=1)
    with zipfile.ZipFile(policy.path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    for damaged in (b"", b"no array", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()):
        with zipfile.ZipFile(policy.path, "w") as archive:
            for name, data in (content | {"scale.npy": damaged}).items():
                archive.writestr(name, data)
        with pytest.raises(mf.BadInput, match=r"policy .*p\.npz: "):
            env.policy(policy.path)
