"""The ways of learning, and flights of each until the swarm knows 90 % of the digits."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from meanflock.studies import published
from meanflock.studies.leaderboard import missions
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario

EXAMPLES = published.DOCS.parent / "examples"
PLUGINS = (Path(__file__).with_name("digits.py"), EXAMPLES / "fedbuff.py")
OUT = Path("out") / "price-of-accuracy"
FIRST_SEED = 196201  # no other study uses these seeds
TUNING_SEED = 196301
SEEDS, FLOWER_SEEDS = 10, 3
RATES = (0.3, 1.0)  # learning rates of which every way has its best in every mission; 0.1 was slower in the pilot
LIMIT_S = 150.0
PAPER, LOSSY, WINDY = "paper", "lossy", "windy"
BOTH, ALL = (PAPER, LOSSY), (PAPER, LOSSY, WINDY)
FLOWER = "flower-digits"  # name of the app's learner and rule
FLOWN: dict[str, Any] = {
    "uavs": 10,
    "until": "accuracy=0.9",
    "stop": "duration",
    "duration": LIMIT_S,
    "start.centre": [330.0, 220.0],  # so far that no UAV arrives before the limit: those that have count no more
    "training.learner": "digits-numpy",
    "training.fit_s": 1.0,
    "training.power_W": 0.1,  # as much as the paper's craft of five grams takes to hover
    "energy.radio_W": 1.14,
    "energy.receive_W": 0.94,
    "federation.fraction": 1.0,
    "federation.period": 20,
}
RETRIED = {"federation.retries": 3}
INT8 = {"federation.payload": "int8", "federation.broadcast_payload": "int8"}
SLOTS = {PAPER: 3, WINDY: 3, LOSSY: 1}  # of a fragment, as those of float32: an int8 model would go in one message
SLOW = {"training.fit_s": 2.5, "training.spread": 0.5}
APP = {"training.learner": FLOWER, "federation.aggregation": FLOWER}
REFUSE = {"federation.options": {"incomplete": "refuse"}}


class LearningWay(NamedTuple):
    """A way of learning. against: the way that it is compared with; empty for the first of a question."""

    question: str
    settings: dict[str, Any]
    against: str = ""
    missions: tuple[str, ...] = ALL

    @property
    def is_flower(self) -> bool:
        """Returns whether it is the Flower app."""
        return FLOWER in self.settings.values()


def _fedbuff(size: int) -> dict[str, Any]:
    return {"federation.aggregation": "fedbuff", "federation.options": {"size": size}}


WHO, LOSSES, WIDTH, STRAGGLERS, APPS = (
    "Who averages?",
    "Transmit again, or average what arrived?",
    "Fewer bits for each number, or fewer numbers?",
    "Wait for slow UAVs, or average late models?",
    "And a Flower app?",
)
WAYS: dict[str, LearningWay] = {
    "leader": LearningWay(WHO, {}),
    "three clusters": LearningWay(WHO, {"federation.clusters": 3}, "leader"),
    "neighbours": LearningWay(WHO, {"federation.topology": "neighbours"}, "leader"),
    "leader, 1 retry": LearningWay(LOSSES, {"federation.retries": 1}, "leader"),
    "leader, 3 retries": LearningWay(LOSSES, RETRIED, "leader"),
    "int8": LearningWay(WIDTH, RETRIED | INT8, "leader, 3 retries"),
    "half of each model": LearningWay(WIDTH, RETRIED | {"federation.share": 0.5}, "leader, 3 retries", BOTH),
    "a quarter of each model": LearningWay(WIDTH, RETRIED | {"federation.share": 0.25}, "leader, 3 retries", (PAPER,)),
    "personal output layer": LearningWay(
        WIDTH, RETRIED | {"training.keeps": ["second*"]}, "leader, 3 retries", (PAPER,)
    ),
    "FedAvg, every 2 s": LearningWay(STRAGGLERS, RETRIED | SLOW, "", BOTH),
    "FedAvg, every 6 s": LearningWay(STRAGGLERS, RETRIED | SLOW | {"federation.period": 60}, "FedAvg, every 2 s", BOTH),
    "FedBuff of 5": LearningWay(STRAGGLERS, RETRIED | SLOW | _fedbuff(5), "FedAvg, every 2 s", BOTH),
    "FedBuff of 8": LearningWay(STRAGGLERS, RETRIED | SLOW | _fedbuff(8), "FedAvg, every 2 s", BOTH),
    "Flower, mean": LearningWay(APPS, APP),
    "Flower, mean, 3 retries": LearningWay(APPS, APP | RETRIED, "Flower, mean", BOTH),
    "Flower, refuse": LearningWay(APPS, APP | REFUSE, "Flower, mean", BOTH),
    "Flower, refuse, 3 retries": LearningWay(APPS, APP | REFUSE | RETRIED, "Flower, mean", BOTH),
}
MEASURES = {"mbit": "Mbit", "airtime_s": "airtime, s", "energy_J": "J", "seconds": "time, s"}


class MissionWay(NamedTuple):
    """A way in a mission."""

    mission: str
    way: str


Flight = dict[str, Any]


def fly(jobs: int) -> list[Flight]:
    """Rows of all flights. First each case flies every rate once, with another seed, and its fastest is chosen."""
    from meanflock.flower import plugin
    from meanflock.flower.app import App

    plugins.load_files([*PLUGINS, plugin.write(App.read(EXAMPLES / "flower_app"), OUT / "app")])
    trials = {(case, rate): [scenario(case, rate, TUNING_SEED)] for case in cases() for rate in RATES}
    tuned = published.flown("price-of-accuracy", trials, jobs)
    rates = {case: min(RATES, key=lambda rate: _cost(*tuned[case, rate])) for case in cases()}
    points = {case: [scenario(case, rates[case], seed) for seed in seeds(case)] for case in cases()}
    return [
        flight_of(case, rates[case], seed, summary)
        for case, summaries in published.flown("price-of-accuracy", points, jobs).items()
        for seed, summary in zip(seeds(case), summaries, strict=True)
    ]


def _cost(summary: Mapping[str, Any]) -> tuple[float, float, float]:
    """What a rate is chosen by: the time of its flight, then how far from 90 % it ended, then its bits."""
    ended = summary["last_round"]
    accuracy = ended.get("metric_accuracy", ended.get("mean_accuracy", 0.0))
    return _seconds(summary), -accuracy, summary["payload_bits"]["total"]


def _seconds(summary: Mapping[str, Any]) -> float:
    return float(summary["until"]["time_s"]) if summary["until"]["reached"] else LIMIT_S


def cases() -> list[MissionWay]:
    """Every case, in the order of the tables."""
    return [MissionWay(mission, name) for name, way in WAYS.items() for mission in way.missions]


def seeds(case: MissionWay) -> range:
    """The seeds of a case."""
    return range(FIRST_SEED, FIRST_SEED + (FLOWER_SEEDS if WAYS[case.way].is_flower else SEEDS))


def scenario(case: MissionWay, rate: float, seed: int) -> Scenario:
    """One flight of a case."""
    way = WAYS[case.way]
    config = {"learning-rate": rate, "num-server-rounds": 1000}
    options = {"run_config": config} if way.is_flower else {"rate": rate}
    slots = {"federation.fragment": SLOTS[case.mission]} if case.way == "int8" else {}
    row = BoardRow(case.way, "orca", settings=FLOWN | {"training.options": options} | way.settings | slots)
    (mission,) = missions.chosen([case.mission])
    return row.scenario(mission.table(), seed, case.mission)


def flight_of(case: MissionWay, rate: float, seed: int, summary: Mapping[str, Any]) -> Flight:
    """Row of one flight in the results: what it cost until it reached 90 %, or until its end."""
    until, traffic = summary["until"], summary["radio"]["traffic"].values()
    reached = until["reached"]
    radio, training = summary["energy_radio_J"], summary["energy_compute_J"]
    return {
        **case._asdict(),
        "rate": rate,
        "seed": seed,
        "reached": reached,
        "rounds": until["round"] if reached else summary["rounds"],
        "mbit": (until["bits"] if reached else summary["payload_bits"]["total"]) / 1e6,
        "airtime_s": until["airtime_s"] if reached else sum(one["airtime_s"] for one in traffic),
        "energy_J": summary["energy_total_J"],
        "flying_J": summary["energy_total_J"] - radio - training,
        "radio_J": radio,
        "training_J": training,
        "seconds": _seconds(summary),
    }
