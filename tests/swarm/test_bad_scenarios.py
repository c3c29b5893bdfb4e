"""A scenario with something wrong in it is bad input: one line that names the key and what to do."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.channel import link
from meanflock.federation.plan import plan_of
from meanflock.federation.schedule import Schedule
from meanflock.launch.engine import Engine
from meanflock.swarm import scenario
from meanflock.swarm.errors import EXIT_BAD_INPUT, BadInput
from meanflock.swarm.scenario import Scenario, Wind, load

REMEDY = "`meanflock scenario schema`"
# Text of a scenario, then parts of the line beside MEND.
WRONG_KEYS = [
    ("speed = 3", "speed"),
    ("[wind]\nsgima = 0.1", "wind", "`sgima`", "did you mean `wind.sigma`?"),
    ("[wind]\nfading = 1", "wind", "`fading`", "did you mean `radio.fading`?"),
    ("[rado]\nfading = 1", "`rado`", "did you mean `radio`?"),
    ('[[faults]]\nkind = "kill"\ntick = 3\nuav = [1]', "faults[0]", "`uav`", "did you mean `faults[0].uavs`?"),
    ('[[faults]]\nkind = "kil"\ntick = 3', "faults[0].kind", "expected one of kill, ", "got 'kil'"),
    ('[[faults]]\nkind = "jam"\ntick = 1\nduration_s = 1.0\nuavs = [1]', "faults", "two or more"),
    ('dt = "fast"', "dt", "expected a number, got 'fast'"),
    ("uavs = 2.5", "uavs", "expected a whole number, got 2.5"),
    ('[[groups]]\nname = "a.b"\ncount = 25', "groups[0].name", "expected a letter and at most 31", "got 'a.b'"),
    ("[wind]\nmean = [1.0]", "wind.mean", "expected a list of length >= 2"),
    ("[radio]\nbits_per_float = 31", "radio.bits_per_float", "expected one of 16, 32, 64, got 31"),
    ("dt = inf", "dt", "<= 1000.0"),
    ("[wind]\nmean = [nan, 0.0]", "wind", "mean", "finite"),
]
# Text of a scenario, then all parts of the line: keys that contradict each other.
CONTRADICTIONS = [
    ("uavs = 5\n[federation]\nleader = 5", "federation.leader", "0…4", "name one"),
    ("dt = 0.5\nduration = 0.4", "duration", "dt"),
    ("dt = 2.0\n[wind]\ndrag = 1.0", "dt", "wind.drag", "keep"),
    ("[filter.options]\nreach_m = 1.0", "`filter.options` has no effect without `filter.kind`", "filter.kind=ecbf"),
    ("[wind]\nfield_length = 5.0", "`wind.field_length` has no effect", "wind.field_rms"),
    ("[cost]\nseparation_range = 2.0", "cost.separation_range", "cost.separation="),
    ('until = "accuracy"', "`until` is 'accuracy'", "accuracy=0.9", "loss<=0.3"),
    ('until = "accuracy=nan"', "`until` is 'accuracy=nan'", "accuracy=0.9"),
    ('[federation]\nbyzantine_kind = "noise"', "federation.byzantine_kind", "federation.byzantine_fraction="),
]
TABLES = [*((*row, REMEDY) for row in WRONG_KEYS), *CONTRADICTIONS]
NO_TOML = [
    ("uavs = = 3", "TOML", "line 1"),
    ("uavs = 1\nuavs = 2", "TOML"),
    ("x = " + "[" * 5000 + "]" * 5000, "TOML", "too deep"),
]


def check_line(attempt: Callable[[], Any], *parts: str) -> str:
    """The one line of bad input; it contains all parts."""
    with pytest.raises(BadInput) as caught:
        attempt()
    text = str(caught.value)
    assert len(text.splitlines()) == 1, text
    for part in parts:
        assert part in text
    assert caught.value.exit_code == EXIT_BAD_INPUT
    return text


@pytest.mark.parametrize("row", TABLES + NO_TOML, ids=lambda row: row[0][:40])
def test_a_bad_file_is_bad_input_and_python_code_is_refused_in_the_same_words(row, tmp_path) -> None:
    text, *parts = row
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    said = check_line(lambda: load(path), str(path), *parts)
    check_line(lambda: Scenario.load(path), *parts)
    if row not in NO_TOML:
        table = tomllib.loads(text)
        for attempt in (lambda: Scenario(**table), lambda: Scenario().replace(**table)):
            assert check_line(attempt, *parts).partition(": ")[2] == said.partition(": ")[2]


@pytest.mark.parametrize(
    ("keys", "parts"),
    [
        ({"wind": Wind(sigma=-0.3)}, ("wind.sigma", "a number >= 0.0, got -0.3", REMEDY)),
        ({"wind.mean": np.zeros(3)}, ("`wind.mean` has three numbers", "set `space.dimensions` to 3")),
        ({"obstacles": [{"centre": [9, 9], "radius": -1}]}, ("obstacles[0].radius", "a number >= 0.0, got -1", REMEDY)),
        ({"controller": {1: 2}}, ("controller", "expected text, got {1: 2}", REMEDY)),
        ({"controller": {"file": "\udc80"}}, ("`controller` must be Unicode text, not '\\udc80'", REMEDY)),
        ({"duration": object()}, ("duration", "type object", "give a number")),
        ({"wind": 3, "wind.sigma": 1}, ("wind.sigma", "`wind` is not a table")),
    ],
)
def test_a_wrong_value_of_python_code_is_named_with_its_key_and_bound(keys, parts) -> None:
    for attempt in (Scenario, Scenario().replace, lambda **keys: Scenario.load("swap", **keys)):
        check_line(lambda: attempt(**keys), *parts)  # noqa: B023


@pytest.mark.parametrize(
    ("setting", "parts"),
    [
        ("uavs", ("--set uavs", "key=value")),
        ("uavs=many", ("uavs", "expected a whole number, got 'many'")),
        ("wind.sigma.x=1", ("wind.sigma", "expected a number, got {'x': 1}")),
        ("controller.gain=inf", ("`controller` must be a finite number within ±1e+30, not inf",)),
        ("vehicle.options.curve=[[1.0, nan]]", ("vehicle", "`options` must be a finite number within ±1e+30, not nan")),
        ("wind.mean=[1", ("--set wind.mean=[1:", "not TOML", "Unclosed array")),
        ("federation.agregation=median", ("did you mean `federation.aggregation`?",)),
        ("sigma=0.2", ("did you mean `wind.sigma`?",)),
        ("acceleration_max=2", ("did you mean `vehicle.acceleration_max`?",)),
        ("groups.couriers.method=bvc", ("`groups` are several tables", "name a scenario that has groups")),
        ("lerner.kappa=2", ("did you mean `learner`?",)),
        ("..=1", ()),
    ],
)
def test_a_bad_setting_is_bad_input(setting: str, parts: tuple[str, ...]) -> None:
    check_line(lambda: load(None, [setting]), *parts)


def test_no_key_is_suggested_where_none_is_near() -> None:
    wrong = ("vehicle.speed_max=1", "speed_max=1", "wind.acceleration=1", "wind.range_m=1", "radio.kappa=1")
    for text in ("obstacles=[{x = 1.0}]", "wind.x=1", *wrong):
        said = check_line(lambda: load(None, [text]), "there is no key", REMEDY)  # noqa: B023
        assert "did you mean" not in said


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b'method = "gr\xfc\xdfe"')
    for name, part in (("missing.toml", "readable"), ("", "readable"), ("latin.toml", "TOML")):
        check_line(lambda: load(tmp_path / name), str(tmp_path / name), part)  # noqa: B023
    check_line(lambda: scenario.read_faults(tmp_path / "nofile"), "nofile", "give a readable fault script")
    (tmp_path / "more.toml").write_text('seed = 3\n[[faults]]\nkind = "kill"\nuavs = [1]\ntick = 1')
    check_line(lambda: scenario.read_faults(tmp_path / "more.toml"), "more.toml", "nothing else")


@pytest.mark.parametrize(
    "setting",
    [
        *(
            f"radio.{key}={sign}100000"
            for key in ("target_snr_db", "tx_power_dbm", "noise_psd_dbm_hz")
            for sign in "+-"
        ),
        *(f"{key}=5e-324" for key in ("radio.coherence_time_s", "radio.bandwidth_hz", "dt")),
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
    # An accepted scenario can be flown: every number that the radio and the calendar derive from it exists.
    Schedule(plan_of(loaded))
    assert loaded.max_ticks >= 1
    assert link.slots_needed(loaded.radio, 128) >= 1
    assert np.isfinite(link.slot_success(loaded.radio, np.array([100.0]))).all()


@pytest.mark.parametrize("raw", [b"", b"{", b"[]", b'{"uavs":0}', b'{"uavs":1,"x":2}', b"\xff", b'{"dt":1e999}'])
def test_bad_json_of_the_network_is_bad_input(raw: bytes) -> None:
    with pytest.raises(BadInput):
        scenario.decode(raw)


# Controller, settings, and parts of the line.
BEFORE_TAKE_OFF = [
    ("hjb", ["filter.kind=magic"], ("filter 'magic' is not installed here; ", "there are braking, ecbf")),
    ("hjb", ["filter.kind=ecbf", "filter.options.distance_m=0"], ("filter.options.distance_m: ", "> 0", "'ecbf'")),
    (
        "mfgfl-hf",
        ["sharing.policy=tick"],
        ("`[sharing]` is set, but controller 'mfgfl-hf' shares no states; ", "filter.kind"),
    ),
    ("mfg", ["federation.state_period=5", "cost.separation=1"], ("federation.state_period", "cost.separation")),
    ("windmap", ["controller.spacing_m=1"], ("a map of ", " nodes; at most 1000")),
    ("hjb", ["radio.model=disk"], ("'disk' is not installed here; ", "there are ideal, link-budget, rice")),
    ("hjb", ["radio.options.radius_m=3.0"], ("radio.options",)),
    ("hjb", ["radio.bits_per_float=16", "federation.payload=float32"], ("federation.payload", "16", "narrower")),
    ("hjb", ["federation.broadcast_payload=float64"], ("federation.broadcast_payload", "32", "narrower")),
    ("hjb", ["federation.payload=int4"], ("coding 'int4' is not installed here; ", "float16", "int8")),
    ("mfgfl-h", ["federation.payload_options.steps=3"], ("federation.payload_options", "steps", "'float32'")),
    ("hjb", ["truth.drag=30"], ("unstable with `truth.drag` 30",)),
]


@pytest.mark.parametrize(("method", "settings", "parts"), BEFORE_TAKE_OFF)
def test_a_swarm_that_cannot_fly_is_bad_input_before_take_off(method: str, settings: list[str], parts: Any) -> None:
    check_line(lambda: Engine(load(None, settings, method=method), "refused"), *parts)
