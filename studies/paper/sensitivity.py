"""What the paper left open, made a result: in what share of plausible settings does each claim hold?

The grid flies S0 with one free parameter changed (`sensitivity`) and with all of them drawn at random (`random`). Each
setting is judged as if it were S0, by the same rule; only claims about S0 that its runs alone can decide take part.
"""

from dataclasses import dataclass

import pyarrow as pa
import pyarrow.compute as pc

from meanflock.studies.paper import claims
from meanflock.studies.paper.tables import Results
from meanflock.studies.paper.verdict import HOLDING, NOT_REPRODUCED, NOT_TESTABLE, UNDECIDED, judge
from meanflock.studies.paper.view import View

EXPERIMENTS = ("sensitivity", "random")


@dataclass(frozen=True)
class Share:
    """One claim over all settings.

    holds, undecided, against: number of settings with that verdict. kept_by: settings in which it holds.
    """

    id: str
    holds: int
    undecided: int
    against: int
    kept_by: tuple[str, ...]

    @property
    def settings(self) -> int:
        """Settings that could be judged."""
        return self.holds + self.undecided + self.against


def shares(results: Results) -> list[Share]:
    """The share of every claim that at least one setting can decide, in the order of the claims."""
    views = {setting: View.of(_as_s0(results, setting)) for setting in _settings(results.runs)}
    table = []
    for claim in claims.load():
        if claim.untestable or not claim.scenario.startswith("S0"):
            continue
        judged = {setting: judge(view, claim) for setting, view in views.items()}
        verdicts = [record["verdict"] for record in judged.values()]
        if all(verdict == NOT_TESTABLE for verdict in verdicts):
            continue
        kept = tuple(setting for setting, record in judged.items() if record["verdict"] in HOLDING)
        table.append(Share(claim.id, len(kept), verdicts.count(UNDECIDED), verdicts.count(NOT_REPRODUCED), kept))
    return table


def _settings(runs: pa.Table) -> list[str]:
    own = runs.filter(pc.is_in(runs["experiment"], pa.array(EXPERIMENTS)))
    return list(dict.fromkeys(own["setting"].to_pylist()))


def _as_s0(results: Results, setting: str) -> Results:
    """Only the runs of one setting, under the coordinates of S0."""
    runs = results.runs
    mine = pc.and_(pc.is_in(runs["experiment"], pa.array(EXPERIMENTS)), pc.equal(runs["setting"], setting))
    runs = runs.filter(mine)
    for name, value in (("experiment", "s0"), ("setting", "")):
        place = runs.schema.get_field_index(name)
        column = pa.array([value] * runs.num_rows).cast(runs.schema.field(name).type)
        runs = runs.set_column(place, runs.schema.field(name), column)
    return Results(
        runs=runs,
        series=results.series.slice(0, 0),
        trajectories=results.trajectories.slice(0, 0),
        weights=results.weights.slice(0, 0),
    )
