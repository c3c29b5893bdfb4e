"""One link: closed forms, against SciPy, the oracle and the emulation; and the warning of models that will be lost."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

import meanflock as mf
from meanflock.channel import link as theory
from meanflock.channel import outlook
from meanflock.channel.fading.ideal import Ideal
from meanflock.channel.fading.rice import Rice
from meanflock.channel.link import slots_needed
from meanflock.channel.outlook import outlooks, remedies
from meanflock.channel.tails import binomial_at_most, rice_above
from meanflock.cli.command import main
from meanflock.swarm import toml
from meanflock.swarm.scenario import Radio, Scenario, load
from meanflock.testing import check_controller
from tests.agent.large_model import Large

ORACLE = json.loads((Path(__file__).parents[1] / "oracle" / "radio.json").read_text())
RTOL = 1e-9
LINKS = 20_000

SETTINGS: dict[str, tuple[tuple[str, ...], float, int]] = {  # settings, distance in m, bits
    "the paper's, H upload": ((), 100.0, 108 * 32),
    "the paper's, HF upload": ((), 100.0, 246 * 32),
    "state broadcast": ((), 3.0, 4 * 32),
    "a target often missed": (("target_snr_db=75.7",), 50.0, 246 * 32),
    "SNR ∝ z²": (('fading="power"', "target_snr_db=82.5"), 50.0, 108 * 32),
    "SNR ∝ z², with path loss": (('fading="power"', "target_snr_db=43", "path_loss_exponent=2"), 90.0, 108 * 32),
    "free-space path loss": (("path_loss_exponent=2", "target_snr_db=36"), 80.0, 246 * 32),
    "Rayleigh": (("rice_xi=0", "target_snr_db=69"), 50.0, 108 * 32),
    "one slot only": (("latency_threshold_slots=1", "target_snr_db=74.5"), 50.0, 4 * 32),
    "more slots than the threshold allows": (("latency_threshold_slots=3",), 50.0, 246 * 32),
}

KEYS = ("path_loss_exponent", "rice_chi", "rice_xi", "target_snr_dB", "tx_power_dBm", "noise_psd_dBm_Hz")
KEYS += ("coherence_time_s", "bandwidth_Hz", "latency_threshold_slots")  # of a case of the oracle


def radio(*settings: str) -> Radio:
    return load(None, [f"radio.{setting}" for setting in settings]).radio


def transmit(by: Radio, rng: np.random.Generator, distance_m: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Slots and delivery of a message on each link."""
    return Rice(Rice.Options(), Scenario(radio=by)).transmit(distance_m, bits, rng)


def brute_force(p: float, needed: int, slots: int) -> tuple[float, float]:
    """P[D ≤ D_M] and E[D; D ≤ D_M], term by term."""
    terms = [(d, math.comb(d - 1, needed - 1) * p**needed * (1 - p) ** (d - needed)) for d in range(needed, slots + 1)]
    return math.fsum(q for _, q in terms), math.fsum(d * q for d, q in terms)


def within_four_standard_errors(sample: np.ndarray, expected: float, variance: float | None = None) -> None:
    spread = sample.var() if variance is None else variance
    assert abs(sample.mean() - expected) <= 4 * math.sqrt(spread / len(sample)) + 1e-12


@pytest.mark.parametrize("case", ORACLE, ids=lambda case: f"{case['target_snr_dB']}dB-{case['bits']}b")
def test_the_closed_forms_are_the_oracle_s(case: dict[str, Any]) -> None:
    given = radio(*(f"{key.lower()}={case[key]}" for key in KEYS))
    distance, bits = np.array([case["distance_m"]]), case["bits"]
    success = theory.slot_success(given, distance)
    assert success == pytest.approx([case["slot_success_probability"]], rel=RTOL)
    assert given.bits_per_slot == pytest.approx(case["bits_per_slot"], rel=RTOL)
    assert slots_needed(given, bits) == case["slots_needed"]
    assert slots_needed(given, bits) / success == pytest.approx([case["mean_latency_slots"]], rel=RTOL)
    assert theory.outage(given, success, bits) == pytest.approx([case["latency_outage_probability"]], rel=RTOL)


@pytest.mark.parametrize("slots", [1, 2, 5, 8, 40])
@pytest.mark.parametrize("needed", [1, 2, 4, 9])
def test_outage_and_delivered_latency_are_their_own_sums(needed: int, slots: int) -> None:
    given = radio(f"latency_threshold_slots={slots}")
    bits = math.floor(needed * given.bits_per_slot)
    assert slots_needed(given, bits) == needed
    for p in (0.0, 1e-3, 0.1, 0.5, 0.95, 1.0):
        through, latency = brute_force(p, needed, slots)
        success = np.array([p])
        np.testing.assert_allclose(1 - theory.outage(given, success, bits), [through], rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(theory.delivered_latency(given, success, bits), [latency], rtol=1e-9)


@pytest.mark.parametrize("name", SETTINGS)
def test_successes_outages_and_latencies_are_those_of_the_closed_form(name: str) -> None:
    settings, metres, bits = SETTINGS[name]
    given, draw = radio(*settings), np.random.default_rng(20200309)
    distance = np.full(LINKS, metres)
    p = float(theory.slot_success(given, distance[:1])[0])
    assert 0.05 < p < 1.0 - 1e-6, "a setting that tests nothing"

    one_slot = radio(*(s for s in settings if "threshold" not in s), "latency_threshold_slots=1")
    within_four_standard_errors(transmit(one_slot, draw, distance, 1)[1].astype(float), p, p * (1 - p))

    slots, delivered = transmit(given, draw, distance, bits)
    outage = float(theory.outage(given, np.array([p]), bits)[0])
    within_four_standard_errors((~delivered).astype(float), outage, outage * (1 - outage))
    observed = np.where(delivered, slots, 0).astype(float)
    within_four_standard_errors(observed, float(theory.delivered_latency(given, np.array([p]), bits)[0]))
    np.testing.assert_array_equal(slots[~delivered], given.latency_threshold_slots)
    if delivered.any():
        assert slots[delivered].min() >= slots_needed(given, bits)
        assert slots[delivered].max() <= given.latency_threshold_slots


def test_links_fade_independently() -> None:
    given = radio("target_snr_db=76", "latency_threshold_slots=6")
    n, fading = LINKS, np.random.default_rng(5)
    first, second = (transmit(given, fading, np.full(2 * n, 50.0), 246 * 32) for _ in range(2))
    for one, later in zip(first, second, strict=True):  # slots and delivery, of other links and of the same link later
        for some, others in ((one[0::2], one[1::2]), (one[:n], one[n:]), (one, later)):
            assert abs(np.corrcoef(some, others)[0, 1]) < 4 / math.sqrt(len(some))


def test_the_expectation_of_links_is_the_sum_of_their_closed_forms() -> None:
    metres = np.array([3.0, 60.0, 90.0])
    for by in (radio(), radio("path_loss_exponent=2", "target_snr_db=36")):
        success = theory.slot_success(by, metres)
        assert len(set(success.tolist())) == (3 if by.path_loss_exponent else 1)
        assert theory.slot_success(by, np.zeros(1))[0] == 1.0 or not by.path_loss_exponent
        found = Rice(Rice.Options(), Scenario(radio=by)).expected(metres, 7872)
        each = theory.outage(by, success, 7872), theory.delivered_latency(by, success, 7872)
        assert found == pytest.approx([part.sum() for part in each], rel=1e-12)
        delivered = transmit(by, np.random.default_rng(4), np.tile(metres, LINKS), 7872)[1].reshape(LINKS, 3)
        for got, outage in zip(delivered.T, each[0], strict=True):
            within_four_standard_errors((~got).astype(float), outage, outage * (1 - outage))


def test_the_ideal_channel_delivers_everything_in_the_slots_its_bits_take_and_draws_nothing() -> None:
    by, rng = radio("path_loss_exponent=4", "latency_threshold_slots=1"), np.random.default_rng(1)
    ideal = Ideal(Ideal.Options(), Scenario(radio=by))
    for bits in (1, 128, 7872, 10**6):
        slots, delivered = ideal.transmit(np.array([1.0, 1e6]), bits, rng)
        assert delivered.all()
        assert slots.tolist() == [math.ceil(bits / by.bits_per_slot)] * 2
        assert ideal.expected(np.ones(2), bits) == (0.0, slots.sum())
    assert rng.bit_generator.state == np.random.default_rng(1).bit_generator.state


TAIL_RTOL = 1e-12  # over the range of the scenarios
SMALLEST = 1e-250
SHARES = np.concatenate([[0.0, 1e-12, 1e-3], np.linspace(0.01, 0.99, 99), [1.0 - 1e-9, 1.0]])


def close(found: np.ndarray, expected: np.ndarray, rtol: float = TAIL_RTOL) -> None:
    some = expected > SMALLEST
    assert some.any()
    np.testing.assert_allclose(found[some], expected[some], rtol=rtol)
    assert (found[~some] <= 2 * SMALLEST).all()


@pytest.mark.parametrize(
    ("xi", "chi"), [(6.649, 1.347), (0.0, 1.347), (1e-9, 1.0), (2.0, 0.5), (30.0, 1.0), (99.0, 1.0)]
)
def test_the_amplitude_of_rice_has_the_tail_of_a_noncentral_chi_square(xi: float, chi: float) -> None:
    line = xi / chi
    amplitude = np.concatenate([[0.0, 1e-6], np.linspace(0.01, line + 33.0, 500)])
    found = rice_above((chi * amplitude) ** 2, xi, chi)
    np.testing.assert_allclose(1.0 - found, special.chndtr(amplitude**2, 2.0, line**2), atol=TAIL_RTOL)
    tried = np.abs(amplitude - line) < (33.0 if line < 10.0 else 7.0)  # SciPy fails in farther tails
    squared = amplitude[tried] ** 2
    close(found[tried], stats.ncx2.sf(squared, 2, line**2) if xi else np.exp(-squared / 2))


@pytest.mark.parametrize(
    ("xi", "chi"), [(0.0, 1e-300), (0.0, 1e300), (1e300, 1e-300), (1e300, 1e300), (6.649, 1e-6), (5e-324, 1.0)]
)
def test_extreme_amplitudes_have_a_probability(xi: float, chi: float) -> None:
    found = rice_above(np.array([0.0, 1e-300, 1.0, 1e300, np.inf]), xi, chi)
    assert found[0] == 1.0
    assert found[-1] == 0.0
    assert (np.diff(found) <= 0.0).all()


@pytest.mark.parametrize(
    ("n", "rtol"),
    [*((n, TAIL_RTOL) for n in (1, 2, 5, 8, 9, 16, 40, 100)), (1000, 1e-11), (16_384, 1e-9), (1_000_000, 1e-7)],
)
def test_counts_of_slots_have_the_tails_of_a_binomial_with_fewer_digits_of_many(n: int, rtol: float) -> None:
    for k in range(n) if n <= 100 else (0, 1, n // 4, n // 2, n - 2, n - 1):
        near = np.clip(k / n + np.array([-3.0, -1.0, 0.0, 0.5, 2.0]) / np.sqrt(n), 0.0, 1.0)
        shares = np.concatenate([SHARES, near])
        close(binomial_at_most(k, n, shares, 1.0 - shares), stats.binom.cdf(k, n, shares), rtol)
        close(binomial_at_most(n - k - 1, n, 1.0 - shares, shares), stats.binom.sf(k, n, shares), rtol)


# -- the warning before take-off ---------------------------------------------------------------------------------

LARGE = str(Path(__file__).parents[1] / "agent" / "large_model.py")
WARNING = "an upload of 19,200 bits takes 8 slots; the limit is 8: 97.4 % will be lost. Use federation.fragment=3"


@pytest.mark.parametrize("settings", [("federation.payload=int8",), ("federation.clusters=4",)])
def test_the_expected_share_is_the_share_lost(settings: tuple[str, ...]) -> None:
    fixed = ["federation.fraction=1.0", "duration=2", "federation.period=3", "radio.path_loss_exponent=0.02"]
    flown = load(None, [*fixed, *settings], method="mfgfl-hf")
    runs = [mf.fly(flown, seed=seed).summary["radio"]["traffic"] for seed in range(6)]
    names = {"upload": "uplink", "relay": "relay", "global model": "broadcast"}
    for one in outlooks(flown):
        bills = [run[names[one.message]] for run in runs]
        sent, lost = sum(bill["sent"] for bill in bills), sum(bill["outages"] for bill in bills)
        assert abs(lost / sent - one.lost) < 4.0 * np.sqrt(one.lost / sent) + 0.01


@pytest.mark.parametrize("settings", [("federation.topology=neighbours",), ("federation.clusters=4",)])
def test_the_share_is_that_of_all_links_however_few_are_looked_at_at_once(settings, monkeypatch) -> None:
    flown = load(None, ["uavs=20", "start.spacing=30", *settings], method="mfgfl-h")
    together = outlooks(flown)
    monkeypatch.setattr(outlook, "_LINKS_AT_ONCE", 45)  # those of two senders to all, or of all to their heads
    for one, other in zip(together, outlooks(flown), strict=True):
        assert other._replace(lost=one.lost) == one
        assert 0.0 < other.lost == pytest.approx(one.lost, rel=1e-12)


def test_a_hundred_thousand_uavs_that_send_to_a_leader_take_no_memory_of_all_pairs() -> None:
    """An array of N² numbers would have 75 GiB."""
    upload, model = outlooks(load(None, ["uavs=100000", "start.spacing=0.01"]))
    near, far = outlooks(load(None, ["uavs=4", "start.spacing=0.01"]))
    assert (upload.lost, model.lost) == pytest.approx((near.lost, far.lost), rel=0.05)


def test_every_remedy_helps_alone() -> None:
    mf.register(Large)
    flown = load(None, method="large")
    for one in outlooks(flown):
        settings = re.findall(r"(\S+=\S+) \(([\d.]+) % lost\)", remedies(flown, one.message))
        assert len(settings) == 3
        for setting, share in settings:
            changed = next(
                other for other in outlooks(load(None, [setting], method="large")) if other.message == one.message
            )
            assert 100 * changed.lost == pytest.approx(float(share), rel=0.05)
            assert changed.lost < 0.2 < one.lost


def test_where_fragments_get_through_no_longer_wait_is_advised() -> None:
    mf.register(Large)
    lossy = toml.FOLDER / "lossy.toml"
    for one in outlooks(flown := load(lossy, method="large")):
        assert one.is_bad
        assert remedies(flown, one.message) == "Use federation.fragment=1 (50 % lost) or fewer parameters"
    for one in outlooks(load(lossy, ["federation.fragment=1"], method="large")):
        assert one.fragments == 8
        assert not one.is_bad
    short = load(lossy, method="fed-lspi")  # one slot, which nothing cuts
    assert "radio.latency_threshold_slots=20" in remedies(short, "upload")


SHORT = ["--quiet", "--duration", "1", "--plugin", LARGE]
STUDY = ["--seeds", "1", "--jobs", "1", *SHORT]


@pytest.mark.parametrize(
    "command",
    [
        ["run", "--in-process", "--no-record", "--json", *SHORT, "--method", "large"],
        ["compare", "large", "cruise", *STUDY],
        ["sweep", "wind.sigma=0.1,0.2", "--methods", "large", *STUDY],
        ["doctor", "--plugin", LARGE, "--method", "large"],
    ],
    ids=lambda command: command[0],
)
def test_every_command_that_flies_warns_before_take_off(command, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda *_, **__: None)  # to draw takes longer than to fly
    monkeypatch.setenv("COLUMNS", "1000")
    main(command)
    out, err = capsys.readouterr()
    text = out if command[0] == "doctor" else err
    assert "12 % lost" in text
    assert (WARNING if command[0] != "doctor" else "takes 8 slots") in text


@pytest.mark.parametrize("fly", [lambda: mf.fly(method=Large, duration=1.0), lambda: check_controller(Large)])
def test_python_warns_before_take_off(fly: Callable[[], object], capsys: pytest.CaptureFixture[str]) -> None:
    fly()
    assert WARNING in capsys.readouterr().err


def test_a_flight_that_federated_nothing_says_so(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    flags = ["--in-process", "--no-record", "--quiet", "--duration", "30"]
    assert main(["run", *flags, "--plugin", LARGE, "--method", "large"]) == 0
    assert "nothing was federated" in capsys.readouterr().err
    rule = Path(tmp_path, "fails.py")
    rule.write_text(
        "import meanflock as mf\n\n\nclass Fails(mf.Aggregator):\n    name = 'fails'\n\n"
        "    def step(self, state, uploads):\n        raise OSError('no table')\n"
    )
    flags += ["--plugin", str(rule), "--method", "mfgfl-h"]
    assert main(["run", *flags, "--set", "federation.aggregation=fails"]) == 0
    said = capsys.readouterr().err
    why = "leader: aggregator 'fails' failed in round 1: OSError: no table (fails.py, line 8)"
    assert re.search(
        rf"warning: the aggregation rule failed: {re.escape(why)}; rounds void, for any reason: \d+; all events are in",
        said,
    )
    assert "no model of another UAV arrived" not in said
    assert main(["run", *flags]) == 0
    assert "nothing was federated" not in capsys.readouterr().err
