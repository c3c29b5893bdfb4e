"""Writes data.md, the data dictionary: the registry of quantities, events, and fields of leaderboard and frontier."""

from collections.abc import Iterable
from pathlib import Path

from meanflock.results import event_log, quantities, rounds_table, series
from meanflock.results.quantities import Field
from meanflock.studies.frontier import record
from meanflock.studies.leaderboard import board
from meanflock.studies.leaderboard.measures import MEASURES, Measure
from meanflock.swarm import events

PAGE = Path(__file__).with_suffix(".md")


def page() -> str:
    """The whole page."""
    lines = [
        "# Data: every column and field of a run",
        "",
        "`python docs/data.py` writes this page; a test compares it with the code. Unit 1: a number without a unit.",
        "",
        "## timeseries.parquet",
        "",
        "One row for each tick, from take-off on. *Each*: a list with one entry for each UAV, in the order of UAVs.",
        "*Cumulative*: counted, summed or averaged since take-off. The metadata of the columns say the same",
        "(`description`, `unit`, `cumulative`, and `values` of the status):",
        '`pyarrow.parquet.read_schema(path).field("energy_J").metadata`.',
        "",
        *_table(("column", "unit", "", "cumulative", "what"), map(_column, quantities.COLUMNS_BEFORE)),
        "",
        f"In [space](space.md) {', '.join(f'`{field.key}`' for field in quantities.IN_SPACE)} stand behind those of y.",
        "",
        "Then follows a column for each diagnostic of the controller, under its name. `offline` declares none,",
        "`hjb` all of these but `fpk_residual`, and the other methods of the paper all of them.",
        "",
        *_table(
            ("column", "unit", "", "cumulative", "what"),
            map(_column, map(quantities.diagnostic, quantities.DIAGNOSTICS)),
        ),
        "",
        "Then follow the [columns of the vehicle](your-vehicle.md#in-space-with-an-attitude), as they are at the end",
        "of the tick. `point-mass` has none, `quadrotor` and `multirotor` have these:",
        "",
        *_table(
            ("column", "unit", "", "cumulative", "what"), map(_column, map(quantities.diagnostic, quantities.SHOWN))
        ),
        "",
        "With [groups](groups.md) these columns are those of all groups. A number that a UAV does not have is null:",
        "its controller has no such diagnostic, or its vehicle no such column. Numbers of trainings, as `accuracy`",
        "and `examples`, are null until a training of the UAV is over, and again after one that gave not all metrics.",
        "",
        "The remaining columns are the same for all controllers and vehicles:",
        "",
        *_table(("column", "unit", "", "cumulative", "what"), map(_column, quantities.COLUMNS_AFTER)),
        "",
        f"Numbers of `status`: {series.status_names()}.",
        "",
        "### As CSV",
        "",
        "CSV has no lists. `run.to_csv(path)` and `meanflock plot RUN --csv FILE.csv` write one row for each",
        "tick and UAV, with `tick`, `sim_time_s`, `uav` (the number of the UAV) and all columns marked *each*.",
        '`run.frame("uav")` is the same as a PyArrow table, and `run.to_pandas()` the same as a DataFrame, if',
        'pandas is installed. `run.to_csv(path, "tick")` or `--per tick` writes one row for each tick, without lists.',
        "Floats read back as the same float64; pandas before 3.1 needs",
        '`read_csv(path, float_precision="round_trip")` for that.',
        "",
        "## rounds.parquet",
        "",
        "One row for each round of the federation; there is no file without rounds. `run.rounds()` is the same table,",
        "and `meanflock show RUN --rounds` prints it.",
        "",
        *_table(("column", "what"), ((f"`{name}`", about) for name, (_, about) in rounds_table.COLUMNS.items())),
        "",
        f"Then follow `{rounds_table.MEAN}…`, the mean of each diagnostic at the end of the round over the UAVs on the",
        f"way, and `{rounds_table.METRIC}…`, what the learners report.",
        "",
        "## summary.json",
        "",
        "One object. A dot leads into an object inside it; `*` stands for any name. Unknown values are `null`, not 0.",
        "",
        "UAVs move straight from tick to tick. Collisions, the closest approach and obstacle hits are measured on",
        "these segments, so a pair that passes between two ticks counts. A UAV that diverged flies no segment in",
        "that tick, and a UAV on the ground flies none. φ_C is measured at ticks, as the paper defines it.",
        "",
        "The fields `diagnostics.*` are sums over all ticks and over the UAVs that were on the way. A sum grows with",
        "the duration of the flight and with the number of UAVs, so that of an accuracy may be in the thousands. The",
        "time series has the diagnostic of each UAV in each tick.",
        "",
        *_table(("field", "unit", "what"), map(_field, quantities.SUMMARY)),
        "",
        "## leaderboard.json",
        "",
        "The result of `meanflock leaderboard`, one object. `courses` is a list, and so is `standings` in each course.",
        "",
        *_table(("field", "unit", "what"), map(_field, board.FIELDS)),
        "",
        "The measures, in the order of the tables:",
        "",
        *_table(("measure", "unit", "better", "what"), map(_measure, MEASURES)),
        "",
        "## frontier.json",
        "",
        "The result of `meanflock frontier`, one object. `targets`, `cells`, and `policies` and `reached` in each cell",
        "are lists. A flight is free if there was no collision and no obstacle was hit, in flight or after arrival.",
        "",
        *_table(("field", "unit", "what"), map(_field, record.FIELDS)),
        "",
        "## events.jsonl",
        "",
        "One line for each event. A line is an object with these fields:",
        "",
        *_table(("field", "what"), ((f"`{name}`", about) for name, about in event_log.FIELDS.items())),
        "",
        "Each type of event, in the order of kinds; `tick` and `uavs` are in the line itself:",
        "",
        *_table(("kind", "event", "fields", "what"), _events()),
    ]
    return "\n".join(lines) + "\n"


def _events() -> list[tuple[str, ...]]:
    kinds = ((kind, name, each) for name, each in events.TYPES.items() for kind in each.meanings)
    return [
        (f"`{kind}`", f"`{name}`", ", ".join(f"`{field}`" for field in _fields(each)), each.meanings[kind])
        for kind, name, each in sorted(kinds, key=lambda row: events.KINDS.index(row[0]))
    ]


def _fields(event: type[events.BaseEvent]) -> list[str]:
    return [name for name in event.__struct_fields__ if name not in event_log.FIELDS]


def _measure(measure: Measure) -> tuple[str, ...]:
    unit = "1" if measure.unit in ("%", "") else measure.unit
    return f"`{measure.key}`", unit, measure.better, measure.about


def _field(field: Field) -> tuple[str, ...]:
    return f"`{field.key}`", field.unit, field.about


def _column(column: Field) -> tuple[str, ...]:
    each = "each" if column.type.endswith("[]") and column.key != "leader_model" else ""
    return f"`{column.key}`", column.unit, each, "yes" if column.cumulative else "", column.about


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    cells = [head, ("---",) * len(head), *rows]
    return [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in cells]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
