"""A stored run in words: sentences and short texts for terminals and pages."""

import json
from typing import Any

from meanflock.results.stored_run import StoredFolder
from meanflock.swarm.errors import printable
from meanflock.swarm.scenario import Until

UNKNOWN = "–"
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"))
_STATES = {
    "interrupted": "The flight was interrupted after {time}.",
    "unfinished": "The flight did not finish.",
    "flying": "The run still flies.",
}


def number(value: Any) -> str:
    """A number of a summary, at most six digits of a fraction; a dash if it is unknown."""
    if value is None:
        return UNKNOWN
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"


def bits(value: Any, unit: str = "bit") -> str:
    """A number of bits or bytes with a prefix: `1.63 Mbit`."""
    if value is None:
        return UNKNOWN
    size, prefix = next(((size, prefix) for size, prefix in _PREFIXES if value >= size), (1, ""))
    return f"{value / size:.3g} {prefix}{unit}" if value < 999.5 * size else f"{value / size:.0f} {prefix}{unit}"


def setting(value: Any, most: int = 30) -> str:
    """A value of a scenario key as in a scenario file, cut off after `most` characters; a dash if it is unset."""
    return UNKNOWN if value is None else printable(json.dumps(value, ensure_ascii=False), most)


def named(run: StoredFolder, key: str) -> str:
    """`method`, `uavs` or `seed`; a dash if it is unknown."""
    value = run.named(key)
    return UNKNOWN if value is None else printable(str(value))


def arrivals(run: StoredFolder) -> str:
    """Number of the UAVs that arrived, of all: `25/25`."""
    return UNKNOWN if (arrived := run.figure("arrived")) is None else f"{arrived}/{run.named('uavs')}"


def flown(run: StoredFolder) -> str:
    """The flight in words: `25 UAVs under mfgfl-hf in paper +1, seed 7, on 2026-11-25 at 02:05`."""
    uavs, method, seed = (named(run, key) for key in ("uavs", "method", "seed"))
    where = f"{uavs} UAV{'' if uavs == '1' else 's'} under {method} in {run.mission}"
    return f"{where}, seed {seed}, on {run.when.astimezone():%Y-%m-%d at %H:%M}"


_COUNTED = {  # named only if there are any
    "waypoints_reached": "The UAVs reached {} waypoint{}.",
    "turned_back": "{} UAV{} turned back with a low battery.",
    "batteries_empty": "The batteries of {} UAV{} were empty in the air.",
    "obstacle_hits": "UAVs flew into obstacles {} time{}.",
    "grounded": "{} UAV{} came down to the ground on the way.",
    "altitude_violations": "UAVs left the limits of altitude {} time{}.",
}


def outcome(run: StoredFolder) -> str:
    """The result of the flight, in sentences."""
    time = f"{number(run.figure('sim_time_s'))} s"
    sentences = [_STATES[run.status].format(time=time)] if run.status in _STATES else []
    sentences += [f"It failed: {run.failure.rstrip('.')}."] if run.failure else []
    sentences += ["`meanflock resume` flies the rest, from its last checkpoint."] if run.resumable else []
    if run.status in ("interrupted", "unfinished") and not run.resumable:
        sentences.append("It has no checkpoint, so nothing can fly the rest.")
    if run.summary:
        sentences.append(_arrived(run, time))
        sentences.append(_collided(run.figure("collisions")))
        sentences += [
            text.format(count, "" if count == 1 else "s")
            for field, text in _COUNTED.items()
            if (count := run.figure(field))
        ]
        sent, lost = run.figure("payload_bits.total"), run.figure("radio.outage_rate")
        share = "" if lost is None else f", and {100 * lost:.3g} % of all messages on links were lost"
        sentences.append(f"The UAVs sent {bits(sent)}{share}." if sent else "The UAVs sent nothing.")
        rounds, void = run.figure("rounds"), run.figure("rounds_void")
        if rounds or void:
            sentences.append(f"Rounds averaged: {rounds}{f'; void: {void}' if void else ''}.")
        sentences += _target(run)
    return " ".join(sentences)


def _target(run: StoredFolder) -> list[str]:
    """A sentence that says whether a round reached the bound of `until`; none for a flight without a bound."""
    until = run.keys.get("until")
    if until is None or run.figure("until.metric") is None:
        return []
    bound, when = Until.of_text(until), run.figure("until.time_s")
    if when is None:
        return [f"No round reached {bound}."]
    cost = f"after {number(when)} s and {bits(run.figure('until.bits'))}"
    return [f"Round {run.figure('until.round')} reached {bound}, {cost}."]


def _arrived(run: StoredFolder, time: str) -> str:
    mean, lost, landed = run.figure("t_avg_s"), run.figure("lost"), run.figure("landed")
    when = f"none in {time}" if mean is None else f"after {mean:.1f} s on average"
    arrived = f"{run.figure('arrived')} of {run.named('uavs')} UAVs arrived"
    either = ", whether they had arrived or not" if run.figure("arrived") else ""
    others = [f"{lost} were lost"] * bool(lost) + [f"{landed} landed for good{either}"] * bool(landed)
    return f"{'; '.join([f'{arrived}, {when}', *others])}."


def _collided(pairs: Any) -> str:
    if not pairs:
        return "No UAVs collided."
    return "One pair of UAVs collided." if pairs == 1 else f"{pairs} pairs of UAVs collided."
