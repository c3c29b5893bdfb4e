"""The table of a frontier for a terminal of 80 columns."""

from collections.abc import Iterator

from rich.table import Table

from meanflock.studies.frontier.record import FrontierCell, FrontierRecord
from meanflock.studies.leaderboard.tables import not_flown
from meanflock.studies.leaderboard.terminal import empty

CAPTION = (
    "kbit: fewest bits until the last arrival at which the one-sided 95 % bound of the share of free flights reaches "
    "the target, with the policy. Shares against bits of all policies: policies.csv"
)


def tables(record: FrontierRecord) -> Iterator[Table]:
    """A table for each mission and number of UAVs."""
    for mission in record.missions():
        for uavs in record.sizes():
            if cells := record.cells_of(mission, uavs):
                yield _table(record, cells, f"{mission}, {uavs} UAVs")


def notes(record: FrontierRecord) -> list[str]:
    """Remarks on the whole frontier: plans that are too long, rows that did not fly, flights that failed."""
    remarks = [
        f"{target.name} takes {target.flights} flights of a policy, and --seeds allows {record.flights}: "
        "it cannot be reached"
        for target in record.targets
        if target.flights > record.flights
    ]
    remarks += not_flown(record.absent, "; ")
    return remarks + [
        f"{cell.mission}, {cell.uavs} UAVs, {cell.row}, {100 * cell.outage:g} %: a flight failed: {cell.why}"
        for cell in record.cells
        if cell.why
    ]


def best(cell: FrontierCell, survey: int) -> str:
    """The best share of free flights that a policy had in the survey: `9/10 event-4`."""
    policy = cell.policy(cell.best)
    return f"{sum(policy.search.free[:survey])}/{survey} {policy.name}"


def _table(record: FrontierRecord, cells: list[FrontierCell], title: str) -> Table:
    table = empty(title)
    table.add_column("loss\n(%)", justify="right", no_wrap=True)
    for target in record.targets:
        table.add_column(f"{target.name} free\n(kbit)")
    table.add_column("best share\n(flights)")
    for cell in cells:
        found = [
            "never reached" if reached is None else f"{reached.kbit:,.0f} {reached.policy}" for reached in cell.reached
        ]
        table.add_row(
            cell.row, f"{100 * cell.outage:g}", *found, "" if all(cell.reached) else best(cell, record.survey)
        )
    return table
