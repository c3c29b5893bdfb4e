"""The tables of communication.md: distances of the rounding study, and intervals of the flights."""

from meanflock.studies import communication
from meanflock.swarm.scenario import load

PAGE = communication.PAGE.read_text(encoding="utf-8")


def test_the_page_has_the_distances_of_the_rounding_study() -> None:
    flights = [load(None, communication.CLEAR, method="mfgfl-h", seed=seed) for seed in communication.ROUNDING_SEEDS]
    _, _, *rows = communication.rounding({"mfgfl-h": [communication.measure_rounding(flown) for flown in flights]})
    assert len(rows) == 4
    assert all(f"\n{row}\n" in PAGE for row in rows)


def test_only_float64_changes_travel_time_or_energy() -> None:
    """Beside float32 of the same method, the intervals of all rows but one overlap."""
    table = PAGE.partition("<!-- flights -->")[2].partition("<!-- end -->")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "`" in line]
    usual = {row[0]: row for row in rows if row[1] == "float32"}
    apart = []
    for row in rows:
        for column in (5, 6):  # travel time, energy
            (mean, width), (other, its_width) = (map(float, each[column].split(" ± ")) for each in (row, usual[row[0]]))
            if abs(mean - other) > width + its_width:
                apart.append((row[0], row[1], row[column], usual[row[0]][column]))
    ((method, payload, wide, narrow),) = apart
    assert (method, payload) == ("`mfgfl-hf`", "float64")
    assert f"{wide} J where float32 takes {narrow} J" in " ".join(PAGE.split())
