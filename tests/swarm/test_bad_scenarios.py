"""A scenario with something wrong in it is bad input, in one line that helps whoever wrote it."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.channel import theory
from meanflock.channel.link import slots_needed
from meanflock.federation.schedule import Schedule
from meanflock.swarm import scenario
from meanflock.swarm.errors import EXIT_BAD_INPUT, BadInput
from meanflock.swarm.scenario import Scenario, Wind, load

MEND = "`meanflock scenario schema`"
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
    "a word for a number": ('dt = "fast"', "dt", "expected a number, got 'fast'", MEND),
    "a number for a table": ("wind = 3", "wind", "expected a table, got 3", MEND),
    "a table for a number": ("[dt]\na = 1", "dt", "expected a number, got {'a': 1}", MEND),
    "a fraction of a UAV": ("uavs = 2.5", "uavs", "expected a whole number, got 2.5", MEND),
    "a truth for a count": ("uavs = true", "uavs", "expected a whole number, got true", MEND),
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


@pytest.mark.parametrize("what", [what for what, (_, *parts) in BAD.items() if "TOML" not in parts])
def test_python_code_is_refused_what_a_file_is_refused_in_the_same_words(what: str, tmp_path: Path) -> None:
    text, *parts = BAD[what]
    table, path = tomllib.loads(text), tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput) as of_file:
        load(path)
    for attempt in (lambda: Scenario(**table), lambda: Scenario().replace(**table), lambda: Scenario.load(path)):
        with pytest.raises(BadInput) as caught:
            attempt()
        one_line(caught, *parts)
        assert str(caught.value).partition(": ")[2] == str(of_file.value).partition(": ")[2]


@pytest.mark.parametrize(
    ("keys", "parts"),
    [
        ({"uavs": "x"}, ("uavs", "a whole number, got 'x'", MEND)),
        ({"wind": {"sigma": -0.3}}, ("wind.sigma", "a number >= 0.0, got -0.3", MEND)),
        ({"wind.sigma": -0.3}, ("wind.sigma", "a number >= 0.0, got -0.3", MEND)),
        ({"wind": Wind(sigma=-0.3)}, ("wind.sigma", "a number >= 0.0, got -0.3", MEND)),
        ({"federation.period": "x"}, ("federation.period", "a whole number, got 'x'", MEND)),
        ({"wind.mean": np.zeros(3)}, ("wind.mean", "a list of length 2, got [0.0, 0.0, 0.0]", MEND)),
        ({"obstacles": [{"centre": [9, 9], "radius": -1}]}, ("obstacles[0].radius", "a number > 0.0, got -1", MEND)),
        ({"controller": {1: 2}}, ("controller", "expected text, got {1: 2}", MEND)),
        ({"duration": object()}, ("duration", "holds no object", "give a number")),
        ({"method": 3}, ("method", "3", "give one of these")),
        ({"wind": 3, "wind.sigma": 1}, ("wind.sigma", "`wind` is not a table")),
    ],
)
def test_a_value_python_code_gives_is_named_with_its_key_and_bound(
    keys: dict[str, Any], parts: tuple[str, ...]
) -> None:
    for attempt in (
        lambda: Scenario(**keys),
        lambda: Scenario().replace(**keys),
        lambda: Scenario.load("swap", **keys),
    ):
        with pytest.raises(BadInput) as caught:
            attempt()
        one_line(caught, *parts)


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
        ("uavs=many", ("uavs", "expected a whole number, got 'many'")),
        ("uavs=", ("uavs", "expected a whole number, got ''")),
        ("wind.sigma=nan", ("wind.sigma",)),
        ("controller.gain=inf", ("`controller` must be a finite number within ±1e+30, not inf",)),
        ("vehicle.options.curve=[[1.0, nan]]", ("vehicle", "`options` must be a finite number within ±1e+30, not nan")),
        ("wind.sigma=", ("wind.sigma", "expected a number, got ''")),
        ("wind.sigma.x=1", ("wind.sigma", "expected a number, got {'x': 1}")),
        ("wind.gust=1", ("wind", "gust")),
        ("gust.wind=1", ("gust",)),
        ("wind.mean=[1", ("--set wind.mean=[1:", "not TOML", "Unclosed array")),
        ('method="hjb', ("--set method=", "not TOML")),
        ("radio={fading", ("--set radio={fading", "not TOML")),
        ("wind.mean=3", ("wind.mean", "expected a list, got 3")),
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


@pytest.mark.parametrize("text", ["obstacles=[{x = 1.0}]", "obstacles=[{sigma = 1.0}]", "wind.x=1"])
def test_no_key_is_suggested_where_none_of_that_table_is_meant(text: str) -> None:
    with pytest.raises(BadInput) as caught:
        load(None, [text])
    one_line(caught, "there is no key", MEND)
    assert "did you mean" not in str(caught.value)


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
    Schedule(loaded)
    assert loaded.max_ticks >= 1
    assert slots_needed(loaded.radio, 128) >= 1
    assert np.isfinite(theory.slot_success(loaded.radio, np.array([100.0]))).all()


def test_bad_json_from_the_bus_is_bad_input() -> None:
    for raw in (b"", b"{", b"[]", b'{"uavs":0}', b'{"uavs":1,"x":2}', b"\xff", b'{"dt":1e999}'):
        with pytest.raises(BadInput):
            scenario.decode(raw)


def test_a_method_nobody_knows_is_named_with_those_there_are_and_how_to_have_it() -> None:
    with pytest.raises(
        BadInput, match=r"'telepathy' is not installed here; .*--plugin.*; there are .*hjb, .*mfgfl-hf"
    ) as e:
        load(None, method="telepathy").declared  # noqa: B018  # asked for where it is needed first
    assert "\n" not in str(e.value)
