"""Scenarios: where a value comes from, one hash however it was written, and keys with description and default."""

import hashlib
import os
import pickle
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from meanflock.swarm import scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.toml import shipped


def test_options_win_over_settings_and_settings_over_the_file(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("uavs = 2\nseed = 2\ndt = 0.2\n[wind]\nsigma = 0.2\ndrag = 0.2", encoding="utf-8")
    loaded = load(path, ["seed=3", "dt=0.3", "wind.sigma=0.3"], dt=0.4, method=None)
    assert (loaded.uavs, loaded.seed, loaded.dt) == (2, 3, 0.4)
    assert (loaded.wind.sigma, loaded.wind.drag, loaded.wind.mean) == (0.3, 0.2, (1.0, -1.0))


def test_a_key_of_a_switch_that_is_set_to_off_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text('[filter]\nkind = "none"\noptions.distance_m = 0.5', encoding="utf-8")
    assert load(path).filter.options == {"distance_m": 0.5}  # as a run leaves it
    swept = load(None, ["filter.options.distance_m=0.5", "filter.kind=none"])
    assert swept.filter.options == {"distance_m": 0.5}
    with pytest.raises(BadInput, match="has no effect without"):
        load(path, ["filter.options.distance_m=0.7"])


def test_a_setting_is_a_bare_word_or_any_toml_value() -> None:
    for text in ("hjb", '"hjb"', " hjb "):
        assert load(None, [f"method={text}"]).method == "hjb"
    assert load(None, ["wind.mean=[1, 2.5]"]).wind.mean == (1.0, 2.5)
    assert load(None, ["radio.bandwidth_hz=2_000_000"]).radio.bandwidth_hz == 2e6


SCENARIOS: dict[str, Scenario] = {  # constructed, loaded and replaced in Python
    "paper": Scenario(),
    "tables": Scenario(uavs=9, wind={"sigma": 0.3, "mean": (0.1, 1 / 3)}, radio=load(None, ["radio.rice_xi=5"]).radio),
    "dotted keys": Scenario(uavs=np.int64(9), **{"wind.sigma": np.float32(0.3), "wind.mean": np.array([0.1, 1 / 3])}),
    "options": Scenario(method="spring", controller={"gains": (1.0, 2.0), "names": {"a": 'ä"\n'}, "none": []}),
    "faults": Scenario(faults=[{"kind": "kill", "tick": 3, "uavs": [1]}], obstacles=[{"centre": [0, 9], "radius": 1}]),
    **{path.stem: Scenario.load(path.stem) for path in shipped() if path.stem != "faults"},
    "replaced": Scenario.load("swap", seed=4).replace(method="hjb", **{"truth.drag": 0.2, "federation.period": None}),
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_survives_a_file_a_pickle_and_the_network(name: str, tmp_path: Path) -> None:
    flown = SCENARIOS[name]
    path = flown.save(tmp_path / "my.toml")
    assert Scenario.load(path) == load(path) == flown
    assert os.listdir(tmp_path) == ["my.toml"]
    assert pickle.loads(pickle.dumps(flown)) == scenario.decode(scenario.encode(flown)) == flown.replace() == flown


def test_a_replaced_scenario_is_the_one_that_was_set_from_the_start(tmp_path: Path) -> None:
    first = Scenario(uavs=9, wind={"sigma": 0.3, "drag": 0.2})
    assert first.replace(**{"wind.drag": 0.4}) == Scenario(uavs=9, **{"wind.sigma": 0.3, "wind.drag": 0.4})
    assert first.replace(wind={"drag": 0.4}) == Scenario(uavs=9, **{"wind.drag": 0.4})
    assert first.wind.drag == 0.2
    changed = Scenario.load("windy", **{"wind.sigma": 0.7})
    assert changed == Scenario.load("windy").replace(**{"wind.sigma": 0.7}) == load(Path("windy"), ["wind.sigma=0.7"])


def test_a_printed_scenario_has_the_values_that_are_no_defaults() -> None:
    printed = repr(Scenario(uavs=9, **{"radio.access": "tdma"}))
    assert re.sub(r" \w+=\w+\(\),?", "", printed) == "Scenario(uavs=9, radio=Radio(access='tdma'),)"


def test_a_scenario_that_cannot_be_saved_is_bad_input_and_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"nowhere/my\.toml: .*; name a file in a folder"):
        Scenario().save(tmp_path / "nowhere" / "my.toml")
    with pytest.raises(BadInput, match="TOML has no such value; leave that option out"):
        Scenario(controller={"gain": None}).save(tmp_path / "my.toml")
    assert os.listdir(tmp_path) == []


def test_the_hash_does_not_depend_on_how_a_scenario_was_written(tmp_path: Path) -> None:
    texts = (
        'method = "mfgfl-h"\nuavs = 9\n[wind]\nsigma = 0.2\nmean = [1.0, -1.0]\n[cost]\nc1 = 0.01',
        "[cost]\nc1 = 1e-2\n\n[wind]\nmean = [1, -1]\nsigma = 0.20\n[federation]\nperiod = 100",
    )
    path = tmp_path / "s.toml"
    hashes = set()
    for text, settings_ in zip(texts, ([], ["uavs=9", "method=mfgfl-h"]), strict=True):
        path.write_text(text, encoding="utf-8")
        hashes.add(load(path, settings_).sha256())
    hashes.add(load(None, ["wind.sigma=0.2", "cost.c1=0.01", "uavs = 9"], method="mfgfl-h").sha256())
    assert len(hashes) == 1
    assert load(None, ["uavs=9"], method="mfgfl-h").sha256() not in hashes


@pytest.mark.parametrize("bits", [16, 32, 64])
def test_a_payload_of_the_radio_s_width_leaves_no_trace_in_the_hash(bits: int) -> None:
    left_out = load(None, [f"radio.bits_per_float={bits}"])
    federation = left_out.resolved().federation
    assert (federation.payload, federation.broadcast_payload) == (f"float{bits}", f"float{bits}")
    table = msgspec.to_builtins(left_out.resolved())  # as the first version wrote it
    for later in (key for key, described in scenario.keys_of(Scenario).items() if described.later):
        part, _, key = later.rpartition(".")
        if part in ("", *table):  # else the table is gone as a whole
            del (table[part] if part else table)[key]
    first = hashlib.sha256(msgspec.json.encode(table, order="sorted")).hexdigest()
    assert left_out.sha256() == left_out.resolved().sha256() == first
    assert load(None, [f"radio.bits_per_float={bits}", "federation.payload=int8"]).sha256() != first


def test_a_shipped_scenario_is_found_from_any_folder_and_a_file_of_that_name_comes_first(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load(Path("paper")).sha256() == load(None).sha256()
    assert load(Path("scenarios/hierarchical.toml")).federation.clusters == 5
    assert len(scenario.read_faults(Path("scenarios/faults.toml"))) > 3
    with pytest.raises(BadInput, match=r"scenarios/none\.toml: .* or name one of crowd, faults, "):
        load(Path("scenarios/none.toml"))
    with pytest.raises(BadInput, match=r"give a readable scenario file$"):
        load(Path("mine.toml"))
    with pytest.raises(BadInput, match=r"swop: .* streams, swap, "):
        load(Path("swop"))
    assert load(Path("swap")).destination.goals == "opposite"
    own = tmp_path / "scenarios" / "hierarchical.toml"
    own.parent.mkdir()
    own.write_text("uavs = 3")
    assert load(Path("scenarios/hierarchical.toml")).uavs == 3


def test_a_default_of_a_group_that_is_written_out_or_sent_to_a_process_leaves_the_hash() -> None:
    group = {"name": "a", "count": 25}
    left_out, written = (Scenario(groups=[group | more]) for more in ({}, {"joins_at_s": float("0")}))
    sent = pickle.loads(pickle.dumps(left_out))
    assert left_out.sha256() == written.sha256() == sent.sha256()


def test_every_key_is_described() -> None:
    page = (Path(__file__).parents[2] / "docs" / "keys.md").read_text(encoding="utf-8")
    meanings = re.findall(r"^\| `[\w.]+` \| (.*?) \|", page, flags=re.M)
    assert len(meanings) > 100
    assert all(meanings)
