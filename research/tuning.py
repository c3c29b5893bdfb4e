"""Tunes the constants of controllers and filters: every arm with the same budget, missions and seeds.

    python -m research.tuning --jobs 2          # half an hour on two quiet cores; repeat it to go on

All candidates of an arm (`tuning.toml`) fly all missions of the leaderboard with seed 1; the best two fly seeds 2 to
10 as well, and the better one of these is chosen by all ten. A candidate is better if fewer flights are unsafe (a
collision, an obstacle hit, or a UAV that never arrived), and among equals if its objective is less. A learner is tuned
first by its tracking cost, and among equals by safety. The record is docs/results/tuning.json.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from meanflock.net import process
from meanflock.studies import published
from meanflock.studies.job_file import version
from meanflock.studies.leaderboard import flights, missions
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.studies.store import Store
from meanflock.studies.study import Summaries
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

ARMS = Path(__file__).with_name("tuning.toml")
RECORD = published.DOCS / "results" / "tuning.json"
FIRST, REST = range(1, 2), range(2, 11)  # seeds of all candidates, and of the best
FINALISTS = 2
_LEAST = 1e-9  # of a tracking cost, whose logarithm is taken


class Arm(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A controller or filter with the candidates for its constants, see `tuning.toml`."""

    name: str
    method: str
    options: Literal["controller", "filter.options"]
    objective: Literal["trip", "tracking"]
    candidates: tuple[dict[str, Any], ...]
    settings: dict[str, Any] = {}  # msgspec copies it

    def scenario(self, candidate: int, mission: missions.BoardMission, seed: int) -> Scenario:
        """The flight of a candidate."""
        options = {f"{self.options}.{key}": value for key, value in self.candidates[candidate].items()}
        return BoardRow(self.name, self.method, settings=self.settings | options).scenario(
            mission.table(), seed, mission.name
        )


class Score(msgspec.Struct, frozen=True):
    """The result of a candidate.

    unsafe: number of flights with a collision, an obstacle hit or a UAV that never arrived. objective: mean of a
    logarithm over flights: of √(energy · time), or of the tracking cost of a UAV. flights: number of flights.
    """

    unsafe: int
    objective: float
    flights: int


def order(objective: str, found: Score) -> tuple[float, float]:
    """Key of a result; the least is the best."""
    return (found.objective, found.unsafe) if objective == "tracking" else (found.unsafe, found.objective)


def score(objective: str, flown: Sequence[Mapping[str, Any]]) -> Score:
    """Score of summaries; a flight that failed counts as unsafe and has no objective."""
    whole = [result for result in flown if flights.FAILED not in result]
    unsafe = len(flown) - len(whole) + sum(map(_is_unsafe, whole))
    values = [_tracking(result) if objective == "tracking" else _trip(result) for result in whole]
    return Score(unsafe, sum(values) / len(values) if values else math.inf, len(flown))


def _is_unsafe(result: Mapping[str, Any]) -> bool:
    return bool(result["collisions_all"] or result["obstacle_hits"] or result["arrived"] < result["uavs"])


def _trip(result: Mapping[str, Any]) -> float:
    return 0.5 * math.log(result["energy_mean_J"] * result["t_avg_censored_s"])


def _tracking(result: Mapping[str, Any]) -> float:
    return math.log(max(result["diagnostics"]["tracking_cost"] / result["uavs"], _LEAST))


def arms() -> tuple[Arm, ...]:
    """The arms of tuning.toml.

    Raises:
        BadInput: two arms have different numbers of candidates, so different budgets.
    """
    found = msgspec.toml.decode(ARMS.read_bytes(), type=dict[str, tuple[Arm, ...]])["arm"]
    if len({len(arm.candidates) for arm in found}) > 1:
        sizes = ", ".join(f"{arm.name} {len(arm.candidates)}" for arm in found)
        raise BadInput(f"{ARMS.name}: all arms must have the same number of candidates; they have {sizes}")
    return found


def main() -> None:
    """Fly the missing runs and write the record."""
    parser = published.options(__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/tuning"), help="folder of the flights")
    parser.add_argument("--arms", nargs="+", metavar="NAME", help="tune these arms only, and keep the record of others")
    given = parser.parse_args()
    wanted = _chosen(given.arms)
    Store(given.out).claim()
    found = [tuned(wanted, given.jobs, given.out), *([_read(RECORD)] if given.arms and RECORD.exists() else [])]
    write({name: record for each in reversed(found) for name, record in each.items()})
    print(RECORD)


def tuned(wanted: Sequence[Arm], jobs: int, out: Path) -> dict[str, Any]:
    """Records by the name of the arm: candidates with their scores, and the chosen one.

    Raises:
        RunFailed: interrupted, disk full or a process died; the same call flies the rest.
    """
    every = missions.chosen([missions.ALL])
    first = _flown({arm.name: (arm, range(len(arm.candidates)), FIRST) for arm in wanted}, every, jobs, out)
    finalists = {arm.name: _best(arm, {k: first[arm.name, k] for k in range(len(arm.candidates))}) for arm in wanted}
    rest = _flown({arm.name: (arm, finalists[arm.name], REST) for arm in wanted}, every, jobs, out)
    records = {}
    for arm in wanted:
        flown = {k: first[arm.name, k] + rest.get((arm.name, k), []) for k in range(len(arm.candidates))}
        scores = {k: score(arm.objective, result) for k, result in flown.items()}
        chosen, *_ = _best(arm, {k: flown[k] for k in finalists[arm.name]})
        records[arm.name] = {
            "code": version(),
            "method": arm.method,
            "settings": arm.settings,
            "objective": arm.objective,
            "seeds": [FIRST[0], REST[-1]],
            "missions": [mission.name for mission in every],
            "acceleration_max_m_s2": missions.ACCELERATION_MAX_M_S2,
            "chosen": arm.candidates[chosen],
            "candidates": [
                {"options": arm.candidates[k]} | msgspec.to_builtins(scores[k]) for k in range(len(arm.candidates))
            ],
        }
    return records


def _best(arm: Arm, flown: Mapping[int, Summaries]) -> list[int]:
    """The best candidates by their summaries, the best first."""
    return sorted(flown, key=lambda k: order(arm.objective, score(arm.objective, flown[k])))[:FINALISTS]


def _flown(
    wanted: Mapping[str, tuple[Arm, Sequence[int], Sequence[int]]],
    every: Sequence[missions.BoardMission],
    jobs: int,
    out: Path,
) -> dict[tuple[str, int], Summaries]:
    """Summaries of all missions, by arm and candidate. wanted: for each arm its candidates and seeds."""
    points = {
        (name, k, mission.name): [arm.scenario(k, mission, seed) for seed in seeds]
        for name, (arm, candidates, seeds) in wanted.items()
        for k in candidates
        for mission in every
    }
    found = published.flown("tuning", points, jobs, flights.fly, out)
    summaries: dict[tuple[str, int], Summaries] = {}
    for (name, k, _), flown in found.items():
        summaries.setdefault((name, k), []).extend(flown)
    return summaries


def _chosen(names: Sequence[str] | None) -> list[Arm]:
    table = {arm.name: arm for arm in arms()}
    if unknown := sorted(set(names or ()) - table.keys()):
        raise BadInput(f"--arms {unknown[0]}: no such arm; there are {', '.join(table)}")
    return [table[name] for name in names] if names else list(table.values())


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def write(records: Mapping[str, Any]) -> None:
    """Writes the record, a line for each arm."""
    lines = (f"{json.dumps(name)}: {json.dumps(record)}" for name, record in records.items())
    RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    process.main(main)
