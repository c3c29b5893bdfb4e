"""What was expected of the flights. It was written before them, after a pilot of one other seed of most ways."""

import math
from typing import NamedTuple

from research.price_of_accuracy.flights import BOTH, LOSSY, PAPER, WINDY, MissionWay


class Expected(NamedTuple):
    """An expectation: a measure of a case, as a multiple of that of another, is between two bounds."""

    words: str
    case: MissionWay
    against: MissionWay
    measure: str
    low: float
    high: float


def _expected(words: str, mission: str, way: str, against: str, measure: str, low: float, high: float) -> Expected:
    return Expected(words, MissionWay(mission, way), MissionWay(mission, against), measure, low, high)


LESS, MORE, ALIKE, THIRD = (0.0, 1.0), (1.0, math.inf), (0.9, 1.1), (0.0, 0.35)
EXPECTED = (
    _expected("neighbours send more bits than a leader", PAPER, "neighbours", "leader", "mbit", *MORE),
    _expected("neighbours are longer on the air than a leader", PAPER, "neighbours", "leader", "airtime_s", *MORE),
    _expected("clusters send as many bits as a leader, within 10 %", PAPER, "three clusters", "leader", "mbit", *ALIKE),
    _expected("neighbours learn faster than a leader", LOSSY, "neighbours", "leader", "seconds", *LESS),
    _expected(
        "neighbours send fewer bits than a leader who retries", LOSSY, "neighbours", "leader, 3 retries", "mbit", *LESS
    ),
    _expected("three retries save time", LOSSY, "leader, 3 retries", "leader", "seconds", *LESS),
    _expected("one retry costs fewer bits than three", LOSSY, "leader, 1 retry", "leader, 3 retries", "mbit", *LESS),
    _expected(
        "three retries change the time by less than 10 %", PAPER, "leader, 3 retries", "leader", "seconds", *ALIKE
    ),
    Expected(
        "wind changes the bits by less than 10 %",
        MissionWay(WINDY, "leader"),
        MissionWay(PAPER, "leader"),
        "mbit",
        *ALIKE,
    ),
    Expected("wind costs energy", MissionWay(WINDY, "leader"), MissionWay(PAPER, "leader"), "energy_J", *MORE),
    _expected("int8 needs at most 35 % of the bits", PAPER, "int8", "leader, 3 retries", "mbit", *THIRD),
    _expected("int8 takes as long, within 10 %", PAPER, "int8", "leader, 3 retries", "seconds", *ALIKE),
    _expected("int8 needs at most 35 % of the bits", LOSSY, "int8", "leader, 3 retries", "mbit", *THIRD),
    _expected(
        "a quarter of the numbers needs more bits than a quarter of the bits of each",
        *(PAPER, "a quarter of each model", "int8", "mbit", *MORE),
    ),
    _expected("half of each model saves bits", PAPER, "half of each model", "leader, 3 retries", "mbit", *LESS),
    _expected("a personal output layer costs bits", PAPER, "personal output layer", "leader, 3 retries", "mbit", *MORE),
    *(
        _expected(f"{way} learns faster than FedAvg every 2 s", mission, way, "FedAvg, every 2 s", "seconds", *LESS)
        for mission in BOTH
        for way in ("FedBuff of 5", "FedAvg, every 6 s")
    ),
    _expected(
        "FedBuff of 8 learns faster than FedAvg every 6 s",
        *(PAPER, "FedBuff of 8", "FedAvg, every 6 s", "seconds", *LESS),
    ),
    *(
        _expected("refusing incomplete replies costs time", mission, "Flower, refuse", "Flower, mean", "seconds", *MORE)
        for mission in BOTH
    ),
    _expected(
        "retries save more time than refusing costs",
        *(LOSSY, "Flower, refuse, 3 retries", "Flower, mean", "seconds", *LESS),
    ),
)
