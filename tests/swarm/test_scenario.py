"""Scenarios: the paper's numbers, bounds on every key, and one line that helps whoever got one wrong."""

import hashlib
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meanflock.channel import theory
from meanflock.channel.link import slots_needed
from meanflock.swarm import scenario
from meanflock.swarm.errors import EXIT_BAD_INPUT, BadInput
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.scenario.switches import SWITCHES
from tests.methods import METHODS

MEND = "`meanflock scenario schema`"

# -- bad input ----------------------------------------------------------------------------------------------------

BAD: dict[str, tuple[str, ...]] = {  # what is wrong: the text as TOML, then what the one line must contain
    "an unknown key": ("speed = 3", "speed", MEND),
    "an unknown key in a table": ("[wind]\nsgima = 0.1", "wind", "`sgima`", "did you mean `wind.sigma`?", MEND),
    "a key of another table": ("[wind]\nfading = 1", "wind", "`fading`", "did you mean `radio.fading`?", MEND),
    "a key without its table": ("period = 100", "`period`", "did you mean `federation.period`?", MEND),
    "a misspelt table": ("[rado]\nfading = 1", "`rado`", "did you mean `radio`?", MEND),
    "a misspelt key of a fault": (
        '[[faults]]\nkind = "kill"\ntick = 3\nuav = [1]',
        "faults[0]",
        "`uav`",
        "did you mean `faults[0].uavs`?",
        MEND,
    ),
    "a fault nobody knows": (
        '[[faults]]\nkind = "kil"\ntick = 3',
        "faults[0].kind",
        "'kil'",
        "choose one of",
        "kill, ",
        MEND,
    ),
    "an unknown table": ("[weather]\nsigma = 0.1", "weather", MEND),
    "a word for a number": ('dt = "fast"', "dt", "expected a number, got text", MEND),
    "a number for a table": ("wind = 3", "wind", "expected a table, got a whole number", MEND),
    "a table for a number": ("[dt]\na = 1", "dt", "expected a number, got a table", MEND),
    "a fraction of a UAV": ("uavs = 2.5", "uavs", "expected a whole number, got a number", MEND),
    "a truth for a count": ("uavs = true", "uavs", "expected a whole number, got true or false", MEND),
    "no UAV": ("uavs = 0", "uavs", ">= 1", MEND),
    "fewer than no UAVs": ("uavs = -3", "uavs", ">= 1", MEND),
    "too many UAVs": ("uavs = 100001", "uavs", "<= 100000", MEND),
    "a negative seed": ("seed = -1", "seed", ">= 0", MEND),
    "a seed too large": ("seed = 4611686018427387905", "seed", "<=", MEND),
    "no time step": ("dt = 0", "dt", ">= 1e-06", MEND),
    "time running backwards": ("dt = -0.1", "dt", ">= 1e-06", MEND),
    "a step that is no number": ("dt = nan", "dt"),
    "a step without end": ("dt = inf", "dt", "<= 1000.0", MEND),
    "wind that is no number": ("[wind]\nsigma = nan", "wind.sigma", MEND),
    "wind without end": ("[wind]\nsigma = inf", "wind", "sigma", "finite", MEND),
    "a mean wind that is no number": ("[wind]\nmean = [nan, 0.0]", "wind", "mean", "finite", MEND),
    "power without end": ("[radio]\ntx_power_dbm = -inf", "radio", "tx_power_dbm", MEND),
    "noise that is no number": ("[radio]\nnoise_psd_dbm_hz = nan", "radio", "noise_psd_dbm_hz", MEND),
    "a mean wind with one component": ("[wind]\nmean = [1.0]", "wind.mean", "expected a list of length 2", MEND),
    "a mean wind with three components": (
        "[wind]\nmean = [1.0, 2.0, 3.0]",
        "wind.mean",
        "expected a list of length 2",
        MEND,
    ),
    "negative spacing": ("[start]\nspacing = -1.0", "start.spacing", "> 0", MEND),
    "a leader outside the swarm": ("uavs = 5\n[federation]\nleader = 5", "federation.leader", "0…4", "name one"),
    "a negative leader": ("[federation]\nleader = -1", "federation.leader", ">= 0", MEND),
    "more than everyone uploads": ("[federation]\nfraction = 1.5", "federation.fraction", "<= 1", MEND),
    "nobody uploads": ("[federation]\nfraction = 0.0", "federation.fraction", "> 0", MEND),
    "rounds without a period": ("[federation]\nperiod = 0", "federation.period", ">= 1", MEND),
    "a float of another width": (
        "[radio]\nbits_per_float = 31",
        "radio.bits_per_float",
        "31",
        "choose one of 16, 32, 64",
        MEND,
    ),
    "a payload nobody knows": (
        '[federation]\npayload = "int4"',
        "federation.payload",
        "int4",
        "choose one of",
        "int8",
        MEND,
    ),
    "a payload wider than a float": (
        '[radio]\nbits_per_float = 16\n[federation]\npayload = "float32"',
        "federation.payload",
        "radio.bits_per_float",
        "narrower",
    ),
    "a broadcast wider than a float": (
        '[federation]\nbroadcast_payload = "float64"',
        "federation.broadcast_payload",
        "float64",
        "32",
        "narrower",
    ),
    "a fading nobody knows": (
        '[radio]\nfading = "rain"',
        "radio.fading",
        "rain",
        "choose one of amplitude, power",
        MEND,
    ),
    "no slots": ("[radio]\nlatency_threshold_slots = 0", "radio.latency_threshold_slots", ">= 1", MEND),
    "an end nobody knows": ('stop = "never"', "stop", "never", "choose one of arrival, duration", MEND),
    "a flight shorter than a tick": ("dt = 0.5\nduration = 0.4", "duration", "dt"),
    "a step too large for the drag": ("dt = 2.0\n[wind]\ndrag = 1.0", "dt", "wind.drag", "keep"),
    "no TOML": ("uavs = = 3", "TOML", "line 1"),
    "half a table": ("[wind\nsigma = 1.0", "TOML", "line 1"),
    "a key twice": ("uavs = 1\nuavs = 2", "TOML"),
    "lists without end": ("x = " + "[" * 5000 + "]" * 5000, "TOML", "too deep"),
    "an option of no filter": ("[filter.options]\nreach_m = 5.0", "`filter.options` does nothing", "filter.kind=ecbf"),
    "a size of no field": ("[wind]\nfield_length = 5.0", "`wind.field_length` does nothing", "wind.field_rms"),
}


def one_line(error: pytest.ExceptionInfo[BadInput], *parts: str) -> None:
    text = str(error.value)
    assert len(text.splitlines()) == 1, text
    for part in parts:
        assert part in text
    assert error.value.exit_code == EXIT_BAD_INPUT


@pytest.mark.parametrize("what", BAD)
def test_a_bad_file_is_bad_input_with_one_line_naming_file_key_and_mend(what: str, tmp_path: Path) -> None:
    text, *parts = BAD[what]
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        load(path)
    one_line(caught, str(path), *parts)


def test_a_file_that_is_not_there_or_cannot_be_read_is_named(tmp_path: Path) -> None:
    missing, folder = tmp_path / "missing.toml", tmp_path
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b'method = "gr\xfc\xdfe"')
    for path, part in ((missing, "readable"), (folder, "readable"), (latin, "TOML")):
        with pytest.raises(BadInput) as caught:
            load(path)
        one_line(caught, str(path), part)


@pytest.mark.parametrize(
    ("setting", "parts"),
    [
        ("uavs", ("--set uavs", "key=value")),
        ("=3", ("--set =3", "key=value")),
        ("uavs=0", ("uavs", ">= 1")),
        ("uavs=many", ("uavs", "expected a whole number, got text")),
        ("uavs=", ("uavs", "expected a whole number, got text")),
        ("wind.sigma=nan", ("wind.sigma",)),
        ("controller.gain=inf", ("`controller` must be a finite number within ±1e+30, not inf",)),
        ("vehicle.options.curve=[[1.0, nan]]", ("vehicle", "`options` must be a finite number within ±1e+30, not nan")),
        ("wind.sigma=", ("wind.sigma", "expected a number, got text")),
        ("wind.sigma.x=1", ("wind.sigma", "expected a number, got a table")),
        ("wind.gust=1", ("wind", "gust")),
        ("gust.wind=1", ("gust",)),
        ("wind.mean=[1", ("--set wind.mean=[1:", "not TOML", "Unclosed array")),
        ('method="hjb', ("--set method=", "not TOML")),
        ("radio={fading", ("--set radio={fading", "not TOML")),
        ("wind.mean=3", ("wind.mean", "expected a list, got a whole number")),
        ("federation.agregation=median", ("did you mean `federation.aggregation`?",)),
        ("..=1", ()),
        ("filter.delta_m=1", ("`filter.delta_m` does nothing without `filter.kind`", "filter.kind=ecbf")),
        ("filter.options.reach_m=9", ("`filter.options` does nothing", "filter.kind=ecbf")),
        ("cost.separation_range=2", ("cost.separation_range", "cost.separation=")),
        ("federation.byzantine_kind=noise", ("federation.byzantine_kind", "federation.byzantine_fraction=")),
    ],
)
def test_a_bad_setting_is_bad_input_with_one_line(setting: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as caught:
        load(None, [setting])
    one_line(caught, *parts)


def test_a_fault_script_that_is_not_there_is_called_one(tmp_path: Path) -> None:
    with pytest.raises(BadInput) as caught:
        scenario.read_faults(tmp_path / "nofile")
    one_line(caught, "nofile", "give a readable fault script")


def test_a_setting_below_a_number_is_told_that_it_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "wind.toml"
    path.write_text("wind = 3", encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        load(path, ["wind.sigma=1"])
    one_line(caught, "wind", "not a table")


@pytest.mark.parametrize(
    "setting",
    [
        "radio.target_snr_db=100000",
        "radio.target_snr_db=-100000",
        "radio.tx_power_dbm=100000",
        "radio.tx_power_dbm=-100000",
        "radio.noise_psd_dbm_hz=100000",
        "radio.noise_psd_dbm_hz=-100000",
        "radio.coherence_time_s=5e-324",
        "radio.bandwidth_hz=5e-324",
        "dt=5e-324",
        "radio.range_m=1e300",
        "destination.radius=1e308",
        'faults=[{kind="jam", time_s=1e300, duration_s=1e308, uavs=[0, 1]}]',
    ],
)
def test_a_number_too_large_or_small_to_compute_with_is_bad_input_before_the_flight(setting: str) -> None:
    try:
        loaded = load(None, [setting])
    except BadInput as error:
        if setting.split("=")[0].split(".")[-1] not in str(error):
            raise
        return
    # Whatever is let in can be flown: every number the radio and the calendar derive from it exists.
    Rounds(loaded)
    assert loaded.max_ticks >= 1
    assert slots_needed(loaded.radio, 128) >= 1
    assert np.isfinite(theory.slot_success(loaded.radio, np.array([100.0]))).all()


def test_bad_json_from_the_bus_is_bad_input() -> None:
    for raw in (b"", b"{", b"[]", b'{"uavs":0}', b'{"uavs":1,"x":2}', b"\xff", b'{"dt":1e999}'):
        with pytest.raises(BadInput):
            scenario.decode(raw)


# -- good input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("uavs", [1, 7, 200])
@pytest.mark.parametrize("method", METHODS)
def test_a_swarm_of_any_size_loads(method: str, uavs: int) -> None:
    loaded = load(None, [f"uavs={uavs}"], method=method)
    assert (loaded.uavs, loaded.method) == (uavs, method)
    assert 1 <= loaded.participants <= uavs


def test_options_win_over_settings_and_settings_over_the_file(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("uavs = 2\nseed = 2\ndt = 0.2\n[wind]\nsigma = 0.2\ndrag = 0.2", encoding="utf-8")
    loaded = load(path, ["seed=3", "dt=0.3", "wind.sigma=0.3"], dt=0.4, method=None)
    assert (loaded.uavs, loaded.seed, loaded.dt) == (2, 3, 0.4)
    assert (loaded.wind.sigma, loaded.wind.drag, loaded.wind.mean) == (0.3, 0.2, (1.0, -1.0))


def test_a_switch_that_is_off_where_it_was_said_to_be_is_what_was_wanted(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text('[filter]\nkind = "none"\ndelta_m = 0.5', encoding="utf-8")
    assert load(path).filter.delta_m == 0.5  # as a run leaves it
    assert load(None, ["filter.delta_m=0.5", "filter.kind=none"]).filter.delta_m == 0.5  # as in a sweep
    with pytest.raises(BadInput, match="does nothing without"):
        load(path, ["filter.delta_m=0.7"])
    on = ["filter.kind=ecbf", "cost.separation=0.1", "wind.field_rms=0.5", "federation.byzantine_fraction=0.2"]
    for switch in on:
        assert load(None, [switch]) != load(None)


def test_the_switches_are_keys_and_off_by_default() -> None:
    plain = msgspec.to_builtins(load(None))
    for table, key, off, example, others in SWITCHES:
        assert plain[table][key] == off
        assert set(others or ()) < set(plain[table])
        load(None, [f"{table}.{key}={example}"])


def test_a_file_may_begin_with_the_mark_some_editors_leave(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(b"\xef\xbb\xbfuavs = 4\r\n")
    assert load(path).uavs == 4


def test_a_setting_is_a_bare_word_or_any_toml_value() -> None:
    for text in ("hjb", '"hjb"', " hjb "):
        assert load(None, [f"method={text}"]).method == "hjb"
    assert load(None, ["wind.mean=[1, 2.5]"]).wind.mean == (1.0, 2.5)
    assert load(None, ["radio.bandwidth_hz=2_000_000"]).radio.bandwidth_hz == 2e6


def test_a_scenario_cannot_be_changed() -> None:
    loaded = load(None)
    with pytest.raises(AttributeError):
        loaded.uavs = 3  # type: ignore[misc]
    with pytest.raises(AttributeError):
        loaded.wind.sigma = 0.0  # type: ignore[misc]


@settings(max_examples=60, deadline=None, database=None)
@given(
    st.fixed_dictionaries(
        {},
        optional={
            "method": st.sampled_from(METHODS),
            "uavs": st.integers(1, 100_000),
            "seed": st.integers(0, 2**62),
            "duration": st.floats(0.2, 1e5),
            "wind": st.fixed_dictionaries({"sigma": st.floats(0, 1e3), "mean": st.tuples(*[st.floats(-50, 50)] * 2)}),
            "federation": st.fixed_dictionaries(
                {"period": st.one_of(st.none(), st.integers(1, 2**40)), "fraction": st.floats(0.01, 1)}
            ),
            "radio": st.fixed_dictionaries({"bits_per_float": st.sampled_from([16, 32, 64])}),
        },
    )
)
def test_a_scenario_survives_the_bus(table: dict[str, Any]) -> None:
    flown = msgspec.convert(table, Scenario)
    received = scenario.decode(scenario.encode(flown))
    assert received == flown
    assert scenario.encode(received) == scenario.encode(flown)
    assert received.sha256() == flown.sha256()


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


def test_what_the_method_decides_is_written_out_in_the_resolved_scenario() -> None:
    for method, period in (("mfgfl-h", 100), ("mfgfl-f", 100), ("mfgfl-hf", 200)):
        loaded = load(None, method=method)
        assert loaded.period_ticks == period
        assert loaded.resolved().federation.period == period
        assert loaded.resolved().sha256() == loaded.sha256()
    assert load(None, ["federation.period=7"]).period_ticks == 7


@pytest.mark.parametrize("bits", [16, 32, 64])
def test_payloads_left_out_are_the_radio_s_floats_written_out_and_leave_no_trace_in_the_hash(bits: int) -> None:
    left_out = load(None, [f"radio.bits_per_float={bits}"])
    federation = left_out.resolved().federation
    assert (federation.payload, federation.broadcast_payload) == (f"float{bits}", f"float{bits}")
    table = msgspec.to_builtins(left_out.resolved())  # as the first version wrote it
    for later in scenario.LATER:
        part, _, key = later.rpartition(".")
        del (table[part] if part else table)[key]
    first = hashlib.sha256(msgspec.json.encode(table, order="sorted")).hexdigest()
    assert left_out.sha256() == left_out.resolved().sha256() == first
    assert load(None, [f"radio.bits_per_float={bits}", "federation.payload=int8"]).sha256() != first


# -- what it says of itself ---------------------------------------------------------------------------------------


def leaves(schema: dict[str, Any], node: dict[str, Any], path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every leaf key with what the schema says of it."""
    for name, entry in node["properties"].items():
        target = entry
        for part in (entry, *entry.get("allOf", []), *entry.get("anyOf", [])):
            if "$ref" in part:
                target = schema["$defs"][part["$ref"].rsplit("/", 1)[-1]]
        if "properties" in target:
            yield from leaves(schema, target, f"{path}{name}.")
        else:
            yield f"{path}{name}", entry


def test_the_schema_describes_every_leaf_key() -> None:
    schema = scenario.schema()
    root = schema["$defs"]["Scenario"]
    found = dict(leaves(schema, root))

    def says(entry: dict[str, Any]) -> bool:
        return any(part.get("description") for part in (entry, *entry.get("anyOf", [])))

    assert [name for name, entry in found.items() if not says(entry)] == []

    def keys(table: dict[str, Any], path: str = "") -> Iterator[str]:
        for name, value in table.items():
            if isinstance(value, dict) and value:  # options of a plug-in are a leaf: only it knows them
                yield from keys(value, f"{path}{name}.")
            else:
                yield f"{path}{name}"

    assert set(found) == set(keys(msgspec.to_builtins(load(None))))


def test_a_method_nobody_knows_is_named_with_those_there_are_and_how_to_have_it() -> None:
    with pytest.raises(
        BadInput, match=r"'telepathy' is not installed here; .*--plugin.*; there are .*hjb, .*mfgfl-hf"
    ) as e:
        load(None, method="telepathy").declared  # noqa: B018  # asked for where it is needed first
    assert "\n" not in str(e.value)


PAPER = """
uavs = 25
dt = 0.1
duration = 300.0
stop = "arrival"
[start]
centre = [150.0, 100.0]
height = 40.0
[destination]
radius = 5.0
[wind]
sigma = 0.1
mean = [1.0, -1.0]
drag = 0.1
[cost]
c1 = 0.015
c2 = 0.015
c3 = 0.005
epsilon = 1.0
beta = 1.0
[learner]
mu_h = 0.01
mu_f = 0.01
c_h = 0.5
kappa = 0.01
position_scale = 200.0
velocity_scale = 20.0
[density]
position_bandwidth = 3.0
velocity_bandwidth = 0.7
node_position_std = 5.0
node_velocity_std = 1.5
[federation]
fraction = 0.8
leader = 0
state_period = 0
[radio]
tx_power_dbm = 20.0
bandwidth_hz = 2e6
noise_psd_dbm_hz = -110.0
path_loss_exponent = 0.0
rice_xi = 6.649
rice_chi = 1.347
fading = "amplitude"
target_snr_db = 75.0
coherence_time_s = 50e-6
latency_threshold_slots = 8
bits_per_float = 32
range_m = 100.0
[vehicle]
blade_power = 0.0049
induced_power = 0.0887
parasite_drag = 0.0092
tip_speed = 15.0
induced_velocity = 1.612
[metrics]
collision_radius = 0.1
"""


def test_the_defaults_are_the_numbers_of_the_model(tmp_path: Path) -> None:
    default = msgspec.to_builtins(load(None))
    for name, value in tomllib.loads(PAPER).items():
        if isinstance(value, dict):
            assert {key: list(v) if isinstance(v := default[name][key], tuple) else v for key in value} == value
        else:
            assert default[name] == value
    assert load(None).start.spacing == math.sqrt(2)
    assert load(None).metrics.hazard_radius == math.sqrt(2) / 2
    assert load(None).participants == 20
    assert load(None).max_ticks == 3000


def test_the_paper_s_file_is_the_default_scenario() -> None:
    path = Path(__file__).parents[2] / "scenarios" / "paper.toml"
    assert load(path).sha256() == load(None).sha256()


def test_a_shipped_scenario_is_found_from_any_folder_and_one_s_own_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load(Path("scenarios/hierarchical.toml")).federation.clusters == 5
    assert len(scenario.read_faults(Path("scenarios/faults.toml"))) > 3
    with pytest.raises(BadInput, match=r"scenarios/none\.toml: .* or name one of crowd, faults, "):
        load(Path("scenarios/none.toml"))
    with pytest.raises(BadInput, match=r"give a readable scenario file$"):
        load(Path("paper.toml"))
    with pytest.raises(BadInput, match=r"swop: .* streams, swap, "):
        load(Path("swop"))
    assert load(Path("swap")).destination.goals == "opposite"
    own = tmp_path / "scenarios" / "hierarchical.toml"
    own.parent.mkdir()
    own.write_text("uavs = 3")
    assert load(Path("scenarios/hierarchical.toml")).uavs == 3
