"""Every number that stands in a hand-written sentence of a page is that of the results.

A row of `SENTENCES` is a page, words of it with `{}` for each number, and the numbers as the page writes them, computed
from docs/results, from the record of the benchmarks, from a table of the page that a study wrote, or from the code.
"""

import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import pytest

from benchmarks import scaling
from meanflock.agent.controllers.cruise import CRUISE_M_S
from meanflock.channel.link import slots_needed
from meanflock.kernels.mean_field.layout import MODEL_FLOATS
from meanflock.studies import federation
from meanflock.swarm.scenario import load
from reproduction import grid
from tests.results import (
    LSPI,
    NEAR,
    OUTAGES,
    PAPER,
    QUIET,
    ROOT,
    chosen,
    claim,
    clusters,
    column,
    ends,
    envelope_bytes,
    feedback_gains,
    fewest_kbit,
    first_flight,
    flown,
    free_flights,
    installed,
    kbit,
    leaderboard,
    median,
    median_of,
    more_bits,
    of_fit,
    one_digit,
    per_cent,
    records,
    sent,
    share,
    sparing,
    standing,
    tracking,
    tuned,
    two_digits,
    zenoh_share,
)


class Sentence(NamedTuple):
    """Words of a page with `{}` for each number, and the numbers."""

    page: str
    words: str
    numbers: Callable[[], Sequence[object]]


@cache
def words_of(page: str) -> str:
    return " ".join((ROOT / page).read_text(encoding="utf-8").split())


README, FEDERATION, COMMUNICATION = "README.md", "docs/federation.md", "docs/communication.md"
SCALING, CONTROLLERS, REPRODUCTION = "docs/scaling.md", "docs/controllers.md", "docs/reproduction.md"
ROBUSTNESS, TRAINING = "docs/robustness.md", "docs/train-a-policy.md"
CALM = ("paper", "windy", "unknown", "gusts", "lossy", "windmap")  # missions of 25 UAVs without obstacles
CROWDED = ("swap", "streams", "crowd")

SENTENCES = [
    Sentence(README, "one of [{} controllers](docs/controllers.md)", lambda: [installed("controllers")]),
    Sentence(
        README,
        "arrived │ {} of 25 │ {} lost │ │ travel time, mean │ {} │ s │ │ energy until own arrival, mean │ {} │ J │",
        lambda: [
            first_flight()["arrived"],
            first_flight()["lost"],
            f"{first_flight()['t_avg_s']:.1f}",
            f"{first_flight()['energy_mean_J']:.2f}",
        ],
    ),
    Sentence(
        README,
        "alignment φ_A │ {} │ m/s, lower is better │ │ collisions │ {} │ pairs │ │ uplink payload │ {} │ bits │",
        lambda: [
            f"{first_flight()['phi_A']:.3f}",
            first_flight()["collisions"],
            f"{first_flight()['payload_bits']['uplink']:,}",
        ],
    ),
    Sentence(
        README,
        "outage rate │ {} │ %, closed form {} % │ │ latency, mean │ {} │ slots, closed form {} │",
        lambda: [
            f"{100 * first_flight()['radio']['outage_rate']:.2f}",
            f"{100 * first_flight()['radio']['outage_rate_theory']:.2f}",
            f"{first_flight()['radio']['latency_slots_mean']:.2f}",
            f"{first_flight()['radio']['latency_slots_mean_theory']:.2f}",
        ],
    ),
    Sentence(
        README,
        "The [published leaderboard](docs/leaderboard.md) has {} rows, ten missions and {} seeds.",
        lambda: [
            len({row.name for course in leaderboard().courses for row in course.standings}),
            len(leaderboard().seeds),
        ],
    ),
    Sentence(
        README,
        "On two cores 25 processes fly {} times faster than real time. 25 UAVs in one process fly {} to {} times "
        "faster, and 1000 UAVs in four processes {} times",
        lambda: [
            two_digits(median("networked", "real-time factor, 25 UAVs")),
            two_digits(median("in_process", "real-time factor, hjb")),
            two_digits(median("in_process", "real-time factor, mfgfl-hf")),
            two_digits(median("scale", "real-time factor, 1000 UAVs in 4 processes")),
        ],
    ),
    Sentence(
        README,
        "`orca` needs {} kbit if 3 % of the broadcasts are lost, and {} kbit if half of them are",
        lambda: [f"{fewest_kbit('orca', 64, lost):.0f}" for lost in (0.03, 0.5)],
    ),
    Sentence(README, "so we searched {} settings", lambda: [grid.MAP_SETTINGS + len(grid.KNOWN)]),
    Sentence(FEDERATION, "What {} flights show, {} fresh seeds", lambda: [f"{len(flown()):,}", len(federation.SEEDS)]),
    Sentence(
        FEDERATION,
        "send {} % fewer bits of models than a leader on `paper`, {} % on `unknown`, {} % on `windy` and {} % "
        "on `lossy`",
        lambda: [f"{100 * (1 - share('kbit', where)):.0f}" for where in federation.CALM],
    ),
    Sentence(
        FEDERATION,
        "The tracking cost rises by at most {}; time",
        lambda: [
            per_cent(
                max((tracking("calm", where, QUIET) for where in federation.CALM[:3]), key=lambda found: found.value)
            )
        ],
    ),
    Sentence(
        FEDERATION, "the tracking cost falls to {} of the leader's", lambda: [ends(tracking("calm", "lossy", QUIET))]
    ),
    Sentence(
        FEDERATION,
        "does not help there**: × {} under a leader",
        lambda: [ends(tracking("calm", "lossy", "leader, 0.03, int8"))],
    ),
    Sentence(
        FEDERATION,
        "neighbours are {} times as long on the air as a leader's swarm; with a threshold of 0.03 and 8 bits {} times "
        "on `paper`, {} on `unknown`, {} on `windy` and {} on `lossy`",
        lambda: [
            f"{share('airtime_s', 'paper', 'neighbours'):.1f}",
            *(f"{share('airtime_s', where):.1f}" for where in federation.CALM),
        ],
    ),
    Sentence(
        FEDERATION,
        "a leader leaves {} of {} UAVs without arrival and tracks {} times worse",
        lambda: [
            f"{(column('uavs', *NEAR) - column('arrived', *NEAR)).sum():.0f}",
            f"{column('uavs', *NEAR).sum():.0f}",
            f"{1 / tracking(*NEAR[:2], 'neighbours').value:.0f}",
        ],
    ),
    Sentence(
        FEDERATION,
        "the gains are learned by then. Neighbours track {} better",
        lambda: [per_cent(tracking("trouble", "UAV 0, which leads, is killed at 20 s", "neighbours"))],
    ),
    Sentence(
        FEDERATION,
        "with a fifth of wrong signs and the mean nobody arrives (under a leader {} of 750). With `median` the "
        "comparison is undecided: × {}.",
        lambda: [
            f"{column('arrived', 'trouble', 'a fifth of the uploads has the wrong sign', 'leader').sum():.0f}",
            ends(tracking("trouble", "the same, with the rule `median`", "neighbours")),
        ],
    ),
    Sentence(
        FEDERATION,
        "On `paper` `federation.fraction=0.4` saves {} s and {} J with {} kbit, a threshold of 0.2 {} s and {} J "
        "with {} kbit.",
        lambda: [
            f"{sparing('t_avg_censored_s', 'fraction 0.4'):.2g}",
            f"{sparing('energy_mean_J', 'fraction 0.4'):.2g}",
            two_digits(column("kbit", "sparing", "paper", "fraction 0.4").mean()),
            f"{sparing('t_avg_censored_s', 'threshold 0.2'):.2g}",
            f"{sparing('energy_mean_J', 'threshold 0.2'):.2g}",
            two_digits(column("kbit", "sparing", "paper", "threshold 0.2").mean()),
        ],
    ),
    Sentence(
        FEDERATION,
        "averaging after 1.5 s lowers the leader's tracking cost to {}, and neighbours with that deadline reach {};",
        lambda: [ends(tracking("late", "unknown", f"{way}, deadline 1.5 s")) for way in ("leader", "neighbours")],
    ),
    Sentence(
        COMMUNICATION,
        "`mfgfl-hf` sends {} times fewer bits than with float32. Its outages fall from {} % to below 0.1 %",
        lambda: [
            f"{kbit('mfgfl-hf', 'float32') / kbit('mfgfl-hf', 'int8'):.1f}",
            f"{float(sent('mfgfl-hf', 'float32', OUTAGES).split()[0]):.1f}",
        ],
    ),
    Sentence(
        COMMUNICATION,
        "so {} % of its messages fail. Its UAVs hardly share models, and it takes {} J where float32 takes {} J",
        lambda: [
            f"{float(sent('mfgfl-hf', 'float64', OUTAGES).split()[0]):.0f}",
            *(sent("mfgfl-hf", payload, "energy until own arrival, J") for payload in ("float64", "float32")),
        ],
    ),
    Sentence(
        COMMUNICATION,
        "Feedback makes the error over all rounds {} to {} times smaller.",
        lambda: [one_digit(min(feedback_gains())), one_digit(max(feedback_gains()))],
    ),
    Sentence(
        COMMUNICATION,
        "A slot of the default radio carries {} bits.",
        lambda: [f"{next(bits for bits in range(1, 10**5) if slots_needed(load(None).radio, bits + 1) > 1):,}"],
    ),
    Sentence(
        COMMUNICATION,
        "Each upload has about {} bytes of envelope",
        lambda: [one_digit(envelope_bytes())],
    ),
    Sentence(
        ROBUSTNESS,
        "an outage loses about one upload in {}",
        lambda: [
            {7: "seven", 8: "eight", 9: "nine"}[round(100.0 / float(sent("mfgfl-hf", "float32", OUTAGES).split()[0]))]
        ],
    ),
    Sentence(
        SCALING,
        "**A process** costs about {} times as much as a UAV.",
        lambda: [one_digit(of_fit("b, a process") / of_fit("c, a UAV"))],
    ),
    Sentence(
        SCALING,
        "Bare Zenoh takes about {} of that",
        lambda: ["half" if 0.4 < zenoh_share() < 0.6 else f"{100.0 * zenoh_share():.0f} %"],
    ),
    Sentence(
        SCALING,
        "one for each UAV would take {}, and a tick most of a second",
        lambda: [scaling._bytes(13 * 2**20 * 1e4)],
    ),
    Sentence(SCALING, "upload a model of {} floats every 20 s", lambda: [MODEL_FLOATS]),
    Sentence(
        SCALING,
        "{} to {} % more bits, including",
        lambda: [f"{min(more_bits()):.1f}", f"{max(more_bits()):.1f}"],
    ),
    Sentence(
        SCALING,
        "with {} to {} % of messages lost, {} to {} % of the models reach the mean instead of {} to {} %",
        lambda: [
            f"{bound(clusters(PAPER, name, several=several)):.0f}"
            for name, several in (("lost, %", True), ("in the mean, %", True), ("in the mean, %", False))
            for bound in (min, max)
        ],
    ),
    Sentence(
        SCALING,
        "of 400 UAVs in 5 clusters {} % of messages are lost instead of {} %",
        lambda: [f"{clusters('α = 2', 'lost, %', several=several, uavs='400')[0]:.0f}" for several in (True, False)],
    ),
    Sentence(
        SCALING,
        "the airtime of the busiest receiver falls from {} to {} ms",
        lambda: [
            f"{bound(clusters(PAPER, 'busiest receiver, ms', several=several, uavs='400')):.0f}"
            for bound, several in ((max, False), (min, True))
        ],
    ),
    Sentence(
        TRAINING,
        "With 25 UAVs and no obstacles {} of {} flights are free of collisions;",
        lambda: [free_flights("policy", CALM), 30 * len(CALM)],
    ),
    Sentence(
        TRAINING,
        "`swap`, `streams` and `crowd`, {} of {} is.",
        lambda: [{0: "none"}[free_flights("policy", CROWDED)], 30 * len(CROWDED)],
    ),
    Sentence(
        TRAINING,
        "all flights of {} missions are free of collisions and hits, and {} of 30 on `swap`; on `crowd` {} % of",
        lambda: [
            {9: "nine"}[sum(free_flights("policy-ecbf", [each.name]) == 30 for each in leaderboard().courses)],
            free_flights("policy-ecbf", ["swap"]),
            f"{100 * standing('crowd', 'policy-ecbf').cells['arrived'].mean:.0f}",
        ],
    ),
    Sentence(CONTROLLERS, "the speed of least energy per metre, {} m/s", lambda: [CRUISE_M_S]),
    Sentence(
        CONTROLLERS,
        "a measurement of w at r with standard deviation σ/(c0 √dt), {} m/s",
        lambda: [f"{load(None).wind.sigma / (load(None).wind.drag * math.sqrt(load(None).dt)):.1f}"],
    ),
    Sentence(
        CONTROLLERS,
        "the best two fly seeds 2 to 10 as well, {} flights in all",
        lambda: [f"{sum(each['flights'] for record in records().values() for each in record['candidates']):,}"],
    ),
    *(
        Sentence(CONTROLLERS, f"| {row} | {{}} | {{}}", lambda names=names, shown=shown: tuned(names, shown))
        for row, names, shown in (
            ("`orca`", ("orca",), ("right_bias", "radius_m", "horizon_s", "velocity_gain_1_s")),
            ("`vasarhelyi`", ("vasarhelyi",), ("c_frict", "tau_s")),
            ("`cruise` behind `braking`", ("braking",), ("distance_m", "rate_1_s")),
            ("`potential-field`", ("potential-field",), ("rho0_m",)),
            ("`cruise` behind `ecbf`", ("ecbf",), ("distance_m", "rate_1_s")),
            ("`bvc`", ("bvc",), ("radius_m", "velocity_gain_1_s", "right_bias")),
            ("`olfati-saber`", ("olfati-saber",), ()),
            ("`fed-lspi`, shares gains, data, alone", LSPI, ("gain_factor", "offset_change")),
            ("`rls`, together, alone", ("rls", "rls-alone"), ()),
        )
    ),
    Sentence(
        CONTROLLERS,
        "cost {} times the bits and track worse",
        lambda: [f"{median_of('paper', 'fed-lspi-data', 'kbit') / median_of('paper', 'fed-lspi', 'kbit'):.0f}"],
    ),
    Sentence(
        CONTROLLERS,
        "track best, with a median of {} in place of {} under a leader",
        lambda: [f"{median_of('lossy', row, 'tracking'):.0f}" for row in ("fed-lspi-neighbours", "fed-lspi")],
    ),
    Sentence(
        CONTROLLERS,
        "learns only drag and wind, tracks `unknown` with {}",
        lambda: [f"{median_of('unknown', 'rls', 'tracking'):.1f}"],
    ),
    Sentence(
        CONTROLLERS,
        "and more at κ = 0.02, for {} times the bits",
        lambda: [f"{median_of('paper', 'mfgfl-h-ecbf', 'kbit') / median_of('paper', 'mfg-ecbf', 'kbit'):.0f}"],
    ),
    Sentence(
        CONTROLLERS,
        "the mean logarithm of the tracking cost is {} together and {} alone",
        lambda: [f"{chosen(name)['objective']:.2f}" for name in ("rls", "rls-alone")],
    ),
    Sentence(
        REPRODUCTION,
        "Verdicts for the default use 30 seeds for each point of a grid and {} for S0. The other scenarios use 10 and "
        "{} fresh seeds",
        lambda: [claim("C8")["single_flights"][1], claim("C8")["scenarios"]["paper-slow"]["single_flights"][1]],
    ),
    Sentence(
        REPRODUCTION,
        "The search has {} settings. Four were named before: the default, two with slow steering, and the printed "
        "polynomial. The others are a Latin hypercube of {}.",
        lambda: [grid.MAP_SETTINGS + len(grid.KNOWN), grid.MAP_SETTINGS],
    ),
]


@pytest.mark.parametrize("sentence", SENTENCES, ids=lambda each: f"{each.page}: {each.words[:50]}")
def test_a_sentence_has_the_numbers_of_the_results(sentence: Sentence) -> None:
    expected = sentence.words.format(*sentence.numbers())
    assert re.sub(r"\s+", " ", expected) in words_of(sentence.page)
