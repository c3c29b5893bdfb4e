"""Every number that stands in a hand-written sentence of a page is that of the results.

`SENTENCES` has words of each page with `{}` for each number, and the numbers as the page writes them, computed from
docs/results, from the record of the benchmarks, from a table of the page that a study wrote, or from the code.
"""

import math
import re
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np

from benchmarks import scaling
from meanflock.agent.controllers.cruise import CRUISE_M_S
from meanflock.channel import link
from meanflock.channel.link import slots_needed
from meanflock.federation import fragments
from meanflock.groundstation import disk, memory
from meanflock.kernels.mean_field.layout import MODEL_FLOATS
from meanflock.studies import communication, federation
from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.scenario import load
from reproduction import grid
from tests import results


@cache
def words_of(page: str) -> str:
    return " ".join((results.ROOT / page).read_text(encoding="utf-8").split())


README, FEDERATION, COMMUNICATION = "README.md", "docs/federation.md", "docs/communication.md"
SCALING, CONTROLLERS, REPRODUCTION = "docs/scaling.md", "docs/controllers.md", "docs/reproduction.md"
ROBUSTNESS, TRAINING = "docs/robustness.md", "docs/train-a-policy.md"
FLOWER, SECURITY, YOUR_CONTROLLER = "docs/flower.md", "docs/security.md", "docs/your-controller.md"
SCAFFOLD = "mfgfl-hf-scaffold"
CALM = ("paper", "windy", "unknown", "gusts", "lossy", "windmap")  # missions of 25 UAVs without obstacles
CROWDED = ("swap", "streams", "crowd")

SENTENCES: dict[str, dict[str, Callable[[], Sequence[object]]]] = {
    README: {
        "one of [{} controllers](docs/controllers.md)": lambda: [results.installed("controllers")],
        (
            "│ {} of 25 │ {} lost │ │ travel time, mean │ {} │ s │ │ energy until own arrival, mean │ {} │ J │ │ "
            "alignment φ_A │ {} │ m/s, lower is better │ │ collisions │ {} │ pairs │ │ uplink payload │ {} │ bits │"
        ): lambda: results.shown(
            *("arrived", "lost", "t_avg_s:.1f", "energy_mean_J:.2f", "phi_A:.3f", "collisions", "payload_bits.uplink:,")
        ),
        "outage rate │ {} │ %, closed form {} % │ │ latency, mean │ {} │ slots, closed form {} │": lambda: [
            *(f"{100 * float(rate):.2f}" for rate in results.shown("radio.outage_rate", "radio.outage_rate_theory")),
            *results.shown("radio.latency_slots_mean:.2f", "radio.latency_slots_mean_theory:.2f"),
        ],
        "The [published leaderboard](docs/leaderboard.md) has {} rows, ten missions and {} seeds.": lambda: [
            len({row.name for course in results.leaderboard().courses for row in course.standings}),
            len(results.leaderboard().seeds),
        ],
        (
            "On two cores 25 processes fly {} times faster than real time. 25 UAVs in one process fly {} to {} times "
            "faster, and 1000 UAVs in four processes {} times"
        ): lambda: [
            results.two_digits(results.median("networked", "real-time factor, 25 UAVs")),
            results.two_digits(results.median("in_process", "real-time factor, hjb")),
            results.two_digits(results.median("in_process", "real-time factor, mfgfl-hf")),
            results.two_digits(results.median("scale", "real-time factor, 1000 UAVs in 4 processes")),
        ],
        "`orca` needs {} kbit if 3 % of the broadcasts are lost, and {} kbit if half of them are": lambda: [
            f"{results.fewest_kbit('orca', 64, lost):.0f}" for lost in (0.03, 0.5)
        ],
        "so we searched {} settings": lambda: [grid.MAP_SETTINGS + len(grid.KNOWN)],
        (
            "Of {} claims of the paper {} are reproduced, {} hold by construction, {} are not refuted, {} are not "
            "reproduced, {} are undecided and {} cannot be tested."
        ): lambda: results.verdicts("paper"),
        "{} claims are reproduced in `paper-slow`, where UAVs steer slowly, and {} in `paper-printed`": lambda: [
            results.verdicts(name)[1] for name in ("paper-slow", "paper-printed")
        ],
    },
    FEDERATION: {
        "What {} flights show, {} fresh seeds": lambda: [
            f"{sum(flight['table'] != 'digits' for flight in results.flown()):,}",
            len(federation.SEEDS),
        ],
        (
            "send {} % fewer bits of models than a leader on `paper`, {} % on `unknown`, {} % on `windy` and {} % "
            "on `lossy`"
        ): lambda: [f"{100 * (1 - results.share('kbit', where)):.0f}" for where in federation.CALM],
        "The tracking cost rises by at most {}; time": lambda: [
            results.per_cent(
                max(
                    (results.tracking("calm", where, results.QUIET) for where in federation.CALM[:3]),
                    key=lambda found: found.value,
                )
            )
        ],
        "the tracking cost falls to {} of the leader's": lambda: [results.ratio("calm", "lossy", results.QUIET)],
        "does not help there**: × {} under a leader": lambda: [results.ratio("calm", "lossy", "leader, 0.03, int8")],
        (
            "are {} times as long on the air as a leader's swarm; with a threshold of 0.03 and 8 bits {} times "
            "on `paper`, {} on `unknown`, {} on `windy` and {} on `lossy`"
        ): lambda: [
            f"{results.share('airtime_s', 'paper', 'neighbours'):.1f}",
            *(f"{results.share('airtime_s', where):.1f}" for where in federation.CALM),
        ],
        "a leader leaves {} of {} UAVs without arrival and tracks {} times worse": lambda: [
            f"{(results.column('uavs', *results.NEAR) - results.column('arrived', *results.NEAR)).sum():.0f}",
            f"{results.column('uavs', *results.NEAR).sum():.0f}",
            f"{1 / results.tracking(*results.NEAR[:2], 'neighbours').value:.0f}",
        ],
        "the gains are learned by then. Neighbours track {} better": lambda: [
            results.per_cent(results.tracking("trouble", "UAV 0, which leads, is killed at 20 s", "neighbours"))
        ],
        (
            "with a fifth of wrong signs and the mean nobody arrives (under a leader {} of 750). With `median` the "
            "comparison is undecided: × {}."
        ): lambda: [
            f"{results.column('arrived', 'trouble', 'a fifth of the uploads has the wrong sign', 'leader').sum():.0f}",
            results.ratio("trouble", "the same, with the rule `median`", "neighbours"),
        ],
        (
            "On `paper` `federation.fraction=0.4` saves {} s and {} J with {} kbit, a threshold of 0.2 {} s and {} J "
            "with {} kbit."
        ): lambda: [*results.spared("fraction 0.4"), *results.spared("threshold 0.2")],
        "1.5 s lowers the leader's tracking cost to {}, and neighbours with that deadline reach {};": lambda: [
            results.ratio("late", "unknown", f"{way}, deadline 1.5 s") for way in ("leader", "neighbours")
        ],
        "FedAdam tracks × {} worse on `unknown`.": lambda: [results.ratio("left", "unknown", "FedAdam at the leader")],
        "in place of one that is lost: × {} on `unknown`": lambda: [
            results.ratio("left", "unknown", "the last upload of everybody")
        ],
        (
            "multiplies the tracking cost by {}. With ε = 2 flights have collisions: {} of 30 on `unknown`, and {} on "
            "`lossy`."
        ): lambda: [
            results.ratio("left", "unknown", "private, ε = 9"),
            *(
                (results.column("collisions_all", "left", where, "private, ε = 2") > 0).sum()
                for where in ("unknown", "lossy")
            ),
        ],
        "on the slow radio: × {}, no better": lambda: [
            results.ratio("left", "slow radio", "the same, late uploads count less", "deadline 1.5 s")
        ],
        "flies {} s longer, and {} of 750 UAVs arrive, without it {}.": lambda: [
            f"{results.mixed('t_avg_censored_s', SCAFFOLD).mean() - results.mixed('t_avg_censored_s').mean():.0f}",
            *(f"{results.mixed('arrived', way).sum():.0f}" for way in (SCAFFOLD, "mfgfl-hf")),
        ],
        "of 10⁵ weights goes in {} fragments of {} slots, and the global model is in place {} ticks after": lambda: [
            *results.long_model()
        ],
        (
            "that is {} times the bits of a round with 20 participants, and {} times with 320. "
            "On the default radio a broadcast of 40 keys is lost by {} % of the receivers."
        ): lambda: [
            f"{results.secure_bits(20):.1f}",
            f"{results.secure_bits(320):.0f}",
            f"{results.radio_losses(40 * 256 // 32):.0f}",
        ],
        "246 weights take {} slots of one band, in place of {} for 20 uploads.": lambda: [
            math.ceil(MODEL_FLOATS / 2 / (load(None).radio.coherence_time_s * load(None).radio.bandwidth_hz)),
            f"{20 * link.expected(load(None).radio, np.ones(1), 32 * MODEL_FLOATS)[1]:.0f}",
        ],
    },
    COMMUNICATION: {
        "`mfgfl-hf` sends {} times fewer bits than with float32. Its outages fall from {} % to below 0.1 %": lambda: [
            f"{results.kbit('mfgfl-hf', 'float32') / results.kbit('mfgfl-hf', 'int8'):.1f}",
            f"{float(results.sent('mfgfl-hf', 'float32', results.OUTAGES).split()[0]):.1f}",
        ],
        "{} % of its messages fail. Its UAVs hardly share models, and it takes {} J where float32 takes {}": lambda: [
            f"{float(results.sent('mfgfl-hf', 'float64', results.OUTAGES).split()[0]):.0f}",
            *(results.sent("mfgfl-hf", payload, "energy until own arrival, J") for payload in ("float64", "float32")),
        ],
        "Feedback makes the error over all rounds {} to {} times smaller.": lambda: [
            results.one_digit(min(results.feedback_gains())),
            results.one_digit(max(results.feedback_gains())),
        ],
        "A slot of the default radio carries {} bits.": lambda: [
            f"{next(bits for bits in range(1, 10**5) if slots_needed(load(None).radio, bits + 1) > 1):,}"
        ],
        "Each upload has about {} bytes of envelope": lambda: [results.one_digit(results.envelope_bytes())],
        "with float32 it stays below {}.": lambda: [
            f"{max(results.transmission(name, 'float32', results.RATIO) for name in communication.METHODS) + 0.005:.2f}"
        ],
    },
    ROBUSTNESS: {
        "an outage loses about one upload in {}": lambda: [
            {7: "seven", 8: "eight", 9: "nine"}[
                round(100.0 / float(results.sent("mfgfl-hf", "float32", results.OUTAGES).split()[0]))
            ]
        ],
        "it is three or four of about {} on average": lambda: [
            f"{20 * (1.0 - float(results.sent('mfgfl-hf', 'float32', results.OUTAGES).split()[0]) / 100.0):.0f}"
        ],
    },
    SCALING: {
        "**A process** costs about {} times as much as a UAV.": lambda: [
            results.one_digit(results.of_fit("b, a process") / results.of_fit("c, a UAV"))
        ],
        "Bare Zenoh takes about {} of that": lambda: [
            "half" if 0.4 < results.zenoh_share() < 0.6 else f"{100.0 * results.zenoh_share():.0f} %"
        ],
        "one for each UAV would take {}, and a tick most of a second": lambda: [scaling._bytes(13 * 2**20 * 1e4)],
        "upload a model of {} floats every 20 s": lambda: [MODEL_FLOATS],
        "{} to {} % more bits, including": lambda: [
            f"{min(results.more_bits()):.1f}",
            f"{max(results.more_bits()):.1f}",
        ],
        "with {} to {} % of messages lost, {} to {} % of the models reach the mean instead of {} to {} %": lambda: [
            f"{bound(results.clusters(results.PAPER, name, several=several)):.0f}"
            for name, several in (("lost, %", True), ("in the mean, %", True), ("in the mean, %", False))
            for bound in (min, max)
        ],
        "of 400 UAVs in 5 clusters {} % of messages are lost instead of {} %": lambda: [
            f"{results.clusters('α = 2', 'lost, %', several=several, uavs='400')[0]:.0f}" for several in (True, False)
        ],
        "the airtime of the busiest receiver falls from {} to {} ms": lambda: [
            f"{bound(results.clusters(results.PAPER, 'busiest receiver, ms', several=several, uavs='400')):.0f}"
            for bound, several in ((max, False), (min, True))
        ],
        (
            "up to {} B of `timeseries.parquet`, and in `recording.rrd` up to {} B, or {} B in a swarm of more "
            "than {} UAVs"
        ): lambda: [disk._SERIES_ROW + 4 * 3, disk._RECORDED_ROW, disk._RECORDED_ROW_OF_MANY, disk.LARGE_SWARM],
        "{} kB for a UAV and, if UAVs share states (`hjb`), {} B for a *pair*": lambda: [
            memory.UAV_KB,
            memory.PAIR_BYTES,
        ],
        "From {} 000 UAVs on the memory of all UAVs exceeds {} MiB": lambda: [
            MAX_MEMORY_BYTES // (8 * MODEL_FLOATS * 1000),
            MAX_MEMORY_BYTES >> 20,
        ],
        "From {} 000 UAVs on a round does not fit into one message.": lambda: [
            2**26 // int(0.8 * 4 * MODEL_FLOATS * 1000)
        ],
        "with √N clusters {} to {} times fewer than without clusters": lambda: [
            results.one_digit(bound(results.fewer_received())) for bound in (min, max)
        ],
    },
    TRAINING: {
        "With 25 UAVs and no obstacles {} of {} flights are free of collisions;": lambda: [
            results.free_flights("policy", CALM),
            30 * len(CALM),
        ],
        "`swap`, `streams` and `crowd`, {} of {} is.": lambda: [
            {0: "none"}[results.free_flights("policy", CROWDED)],
            30 * len(CROWDED),
        ],
        "of {} missions are free of collisions and hits, and {} of 30 on `swap`; on `crowd` {} % of": lambda: [
            {9: "nine"}[
                sum(results.free_flights("policy-ecbf", [each.name]) == 30 for each in results.leaderboard().courses)
            ],
            results.free_flights("policy-ecbf", ["swap"]),
            f"{100 * results.standing('crowd', 'policy-ecbf').cells['arrived'].mean:.0f}",
        ],
    },
    CONTROLLERS: {
        "the speed of least energy per metre, {} m/s": lambda: [CRUISE_M_S],
        "a measurement of w at r with standard deviation σ/(c0 √dt), {} m/s": lambda: [
            f"{load(None).wind.sigma / (load(None).wind.drag * math.sqrt(load(None).dt)):.1f}"
        ],
        "the best two fly seeds 2 to 10 as well, {} flights in all": lambda: [
            f"{sum(each['flights'] for record in results.records().values() for each in record['candidates']):,}"
        ],
        **{
            f"| {row} | {{}} | {{}}": lambda names=names, shown=shown: results.tuned(names, shown)
            for row, names, shown in (
                ("`orca`", ("orca",), ("right_bias", "radius_m", "horizon_s", "velocity_gain_1_s")),
                ("`vasarhelyi`", ("vasarhelyi",), ("c_frict", "tau_s")),
                ("`cruise` behind `braking`", ("braking",), ("distance_m", "rate_1_s")),
                ("`potential-field`", ("potential-field",), ("rho0_m",)),
                ("`cruise` behind `ecbf`", ("ecbf",), ("distance_m", "rate_1_s")),
                ("`bvc`", ("bvc",), ("radius_m", "velocity_gain_1_s", "right_bias")),
                ("`olfati-saber`", ("olfati-saber",), ()),
                ("`fed-lspi`, shares gains, data, alone", results.LSPI, ("gain_factor", "offset_change")),
                ("`rls`, together, alone", ("rls", "rls-alone"), ()),
            )
        },
        "send {} times as many bits and track worse": lambda: [
            f"{results.shared_bits('paper', 'fed-lspi-data', 'fed-lspi'):.0f}"
        ],
        "track best, with a median of {} in place of {} under a leader": lambda: [
            f"{results.median_of('lossy', row, 'tracking'):.0f}" for row in ("fed-lspi-neighbours", "fed-lspi")
        ],
        "learns only drag and wind, tracks `unknown` with {}": lambda: [
            f"{results.median_of('unknown', 'rls', 'tracking'):.1f}"
        ],
        "and more at κ = 0.02, and sends {} times as many bits": lambda: [
            f"{results.shared_bits('paper', 'mfgfl-h-ecbf', 'mfg-ecbf'):.0f}"
        ],
        "the mean logarithm of the tracking cost is {} together and {} alone": lambda: [
            f"{results.chosen(name)['objective']:.2f}" for name in ("rls", "rls-alone")
        ],
        "sends less than {} Mbit in all": lambda: [
            f"{math.ceil(max(flight['kbit'] for flight in results.flights_of('fed-lspi')) / 100) / 10:g}"
        ],
        (
            "{} % of its UAVs arrive on `crowd`. On `unknown`, where drag and wind are not those that it was told, {} "
            "% of the UAVs of `cruise` behind `ecbf` arrive, and behind `braking` {} %. On `swap` `orca` flies free of "
            "collisions in {} of 30 flights there, `cruise` behind `braking` in {}, behind `ecbf` in {}, "
            "`potential-field` in {} and `olfati-saber` in {}."
        ): lambda: [
            results.arrived("bvc", "crowd"),
            *(results.arrived(row, "unknown") for row in ("cruise-ecbf", "cruise-braking")),
            *(
                results.free(row)
                for row in ("orca", "cruise-braking", "cruise-ecbf", "potential-field", "olfati-saber")
            ),
        ],
    },
    REPRODUCTION: {
        ("30 seeds for each point of a grid and {} for S0. The other scenarios use 10 and {} fresh seeds"): lambda: [
            results.claim("C8")["single_flights"][1],
            results.claim("C8")["scenarios"]["paper-slow"]["single_flights"][1],
        ],
        (
            "The search has {} settings. Four were named before: the default, two with slow steering, and the printed "
            "polynomial. The others are a Latin hypercube of {}."
        ): lambda: [grid.MAP_SETTINGS + len(grid.KNOWN), grid.MAP_SETTINGS],
        "{} gives the paper's 175 s": lambda: [
            load(None).learner.kappa if results.claim("C18")["verdict"] == "reproduced" else None
        ],
    },
    FLOWER: {
        "A model of 246 floats is {} bits": lambda: [f"{32 * MODEL_FLOATS:,}"],
        "than {} with 64-bit floats, and by {} with 32-bit floats; weighed by their samples, by {} and {}.": lambda: [
            results.scientific(results.median("classifier", f"difference, {bits} bits{way}"))
            for way in ("", ", by samples")
            for bits in (64, 32)
        ],
        "takes {} ms, and all of its processes {} MiB of memory; a round of meanflock takes {} ms and {} MiB": lambda: [
            f"{results.median('classifier', name):,.0f}"
            for name in ("flwr 1.41.0: round", "flwr 1.41.0: memory of all its processes", "our round", "our memory")
        ],
    },
    SECURITY: {
        "A tick of 25 agents takes {} times as long over TLS": lambda: [
            f"{results.median('tls', 'tick over TLS') / results.median('tls', 'tick over TCP'):.2f}"
        ]
    },
    YOUR_CONTROLLER: {
        (
            "loses {} % of the messages of 300 floats and {} % of those of 500 floats, and cannot deliver one of more "
            "than {} floats. A model of more than 622 floats is therefore cut into fragments, each of which is a "
            "message of its own; {} % of them arrive."
        ): lambda: [
            f"{results.radio_losses(300):.0f}",
            f"{results.radio_losses(500):.0f}",
            next(floats for floats in range(10**4) if results.radio_losses(floats + 1) == 100.0),
            f"{100 * fragments.share_delivered(load(None), 3 * int(load(None).radio.bits_per_slot)):.0f}",
        ],
        "of 25 arrives, and {} pairs collide on the way": lambda: re.findall(
            r"# 1 (\d+)$", (results.ROOT / YOUR_CONTROLLER).read_text(encoding="utf-8"), re.M
        ),
    },
}


def written(page: str) -> list[str]:
    """The sentences of a page with their numbers."""
    return [words.format(*numbers()) for words, numbers in SENTENCES.get(page, {}).items()]
