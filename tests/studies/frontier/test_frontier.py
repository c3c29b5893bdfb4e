"""The command `frontier`: its record, its page, interruption and repetition, and what is never reached."""

import csv
import itertools
import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from meanflock.cli import frontier as command
from meanflock.results import statistics
from meanflock.studies import study
from meanflock.studies.frontier import grid, picture, policies, record
from meanflock.studies.frontier.__main__ import main
from meanflock.studies.frontier.grid import Extent, FrontierGrid
from meanflock.studies.frontier.outage import Outages
from meanflock.studies.frontier.page import page
from meanflock.studies.leaderboard import flights, missions, rows
from meanflock.studies.leaderboard.missions import BoardMission
from meanflock.studies.store import Store
from meanflock.swarm.errors import EXIT_DONE, EXIT_RUN_FAILED, BadInput
from meanflock.swarm.scenario import Scenario, load
from tests.studies.conftest import SMALL

SHORT = ("--jobs", "1", "--quiet", "--out", "out")
RULED = ("--controllers", "orca", "plan", "--uavs", "2", "--outages", "30", "50")
RULED += ("--policies", "event", "event-r2", "event-r4", "tick", *SHORT)


@pytest.fixture
def ruled(monkeypatch: pytest.MonkeyPatch) -> list[Scenario]:
    """Replaces flights: an event that is sent once fails in every third flight, beyond an outage of 40 % one that is
    sent twice fails, too, and `plan` always does. Returns the scenarios that were asked for.
    """
    asked: list[Scenario] = []
    monkeypatch.setattr(flights, "fly", following(asked))
    return asked


def following(asked: list[Scenario]) -> Callable[[Scenario], dict[str, Any]]:
    """The rule of `ruled`, which appends each scenario to `asked`."""

    def fly(flown: Scenario) -> dict[str, Any]:
        asked.append(flown)
        rule = flown.sharing.rule
        kbit = 100.0 if rule.broadcast == "tick" else 10.0 * rule.repeats + 20.0 * rule.velocity_delta_m_s
        weak = rule.broadcast == "event" and rule.repeats <= (2 if flown.radio.target_snr_db > 76.3 else 1)
        noise = zlib.crc32(json.dumps([flown.method, rule.repeats, flown.seed]).encode()) % 3
        collides = flown.method == "plan" or (weak and noise == 0)
        bits = {"total": 3200.0 if flown.method == "plan" else 1e3 * kbit + flown.seed % 7}
        return {
            "collisions_all": int(collides),
            "obstacle_hits": 0,
            "bits_to_arrival": bits,
            "arrived": flown.uavs,
            "uavs": flown.uavs,
        }

    return fly


@pytest.mark.usefixtures("undrawn")
def test_short_flights_give_a_table_and_files_and_are_flown_once(run, tmp_path, small, monkeypatch) -> None:
    flags = ("frontier", "--missions", small[0], "--controllers", "orca", "cruise", "--seeds", "2", "--outages", "30")
    flags += ("--policies", "event", "tick", *SHORT)
    code, out, err = run(*flags)
    assert (code, err) == (EXIT_DONE, "")
    assert {"out/frontier.json", "out/policies.csv", "out/pictures/near.png"} <= set(out.splitlines())
    assert max(map(len, out.splitlines())) <= 80
    words = " ".join(out.split())
    assert "orca 30 never reached never reached 2/2 event" in words
    assert "90 % takes 29 flights of a policy, and --seeds allows 2: it cannot be reached" in words
    found = record.read(tmp_path / "out/frontier.json")
    assert [(cell.row, cell.uavs) for cell in found.cells] == [
        (row, uavs) for uavs in (25, 64) for row in ("orca", "cruise")
    ]
    orca, cruise = found.cells_of(small[0], 25)
    assert [policy.name for policy in orca.policies] == ["event", "tick"]
    assert [policy.name for policy in cruise.policies] == [policies.SILENT]
    assert cruise.policies[0].search.kbit == [3.2, 3.2]  # the mission plan alone
    first = (tmp_path / "out/frontier.json").read_bytes()
    monkeypatch.setattr(study, "_fly", lambda *_, **__: pytest.fail("flown again"))
    assert run(*flags)[0] == EXIT_DONE
    assert (tmp_path / "out/frontier.json").read_bytes() == first


@pytest.mark.usefixtures("undrawn")
def test_the_fewest_bits_are_named_and_confirmed_on_fresh_seeds(run, tmp_path, small, ruled) -> None:
    code, out, _ = run("frontier", "--missions", small[0], *RULED)
    assert code == EXIT_DONE
    found = record.read(tmp_path / "out/frontier.json")
    orca, more, plan, again = found.cells
    assert [(cell.row, cell.outage) for cell in (orca, more, plan, again)] == [
        ("orca", 0.3), ("orca", 0.5), ("plan", 0.3), ("plan", 0.5),
    ]  # fmt: skip
    assert [reached.policy for reached in orca.reached if reached] == ["event-r2", "event-r2"]
    assert [reached.policy for reached in more.reached if reached] == ["event-r4", "event-r4"]
    for target, reached in zip(found.targets, orca.reached, strict=True):
        flown = orca.policy("event-r2").confirmation
        assert reached.bound == pytest.approx(0.05 ** (1 / target.flights))
        assert reached.bound >= target.share
        mean = statistics.mean(flown.kbit[: target.flights])
        assert (reached.kbit, reached.kbit_low, reached.kbit_high) == pytest.approx((mean.value, mean.low, mean.high))
    assert orca.policy("event").verdicts == ["collisions", "collisions"]
    assert orca.policy("tick").verdicts == ["not needed", "not needed"]
    assert len(orca.policy("tick").search.free) == 2
    assert len(orca.policy("event").search.free) == found.survey == 10
    assert plan.reached == [None, None]
    assert orca.error == pytest.approx(4 * 0.05**2)
    assert "plan 30 never reached never reached 0/10 silent" in " ".join(out.split())
    seeds = {one.seed for one in ruled}
    assert min(seeds) == found.first_seed == 94001
    assert {seed for seed in seeds if seed >= found.confirmation_seed} == set(range(95001, 95060))
    assert max(seed for seed in seeds if seed < found.confirmation_seed) == 94059
    with (tmp_path / "out/policies.csv").open(newline="") as file:
        table = {(row["row"], row["outage"], row["policy"]): row for row in csv.DictReader(file)}
    free = orca.policy("event").search.free
    assert table["orca", "0.3", "event"]["free"] == str(sum(free))
    low = statistics.share(free).low
    assert float(table["orca", "0.3", "event"]["low"]) == pytest.approx(low, abs=1e-4)


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_search_goes_on_to_the_same_record(run, tmp_path, small, ruled, monkeypatch) -> None:
    whole = flights.fly
    assert run("frontier", "--missions", small[0], *RULED[:-1], "whole")[0] == EXIT_DONE
    number = len(ruled)
    ruled.clear()

    def interrupted(flown):
        if len(ruled) == number // 2:
            raise KeyboardInterrupt
        return whole(flown)

    monkeypatch.setattr(flights, "fly", interrupted)
    code, out, err = run("frontier", "--missions", small[0], *RULED)
    assert (code, out) == (EXIT_RUN_FAILED, "")
    assert "repeat the command" in err
    monkeypatch.setattr(flights, "fly", whole)
    assert run("frontier", "--missions", small[0], *RULED)[0] == EXIT_DONE
    assert len(ruled) == number
    records = [(tmp_path / folder / "frontier.json").read_bytes() for folder in ("whole", "out")]
    assert records[0] == records[1]


def test_a_row_that_cannot_fly_and_a_flight_that_fails_are_named(run, tmp_path, small, ruled, monkeypatch) -> None:
    monkeypatch.setattr(flights, "fly", lambda _: {flights.FAILED: "out of ideas"})
    flags = ("--controllers", "plan", "straight", "--uavs", "2", "--outages", "3", "--seeds", "2")
    code, out, _ = run("frontier", "--missions", small[0], *flags, *SHORT)
    assert code == EXIT_DONE
    found = record.read(tmp_path / "out/frontier.json")
    assert found.absent == {f"{small[0]}, 2 UAVs, straight": "flies windmap only"}
    assert found.cells[0].why == "out of ideas"
    words = " ".join(out.split())
    assert "a flight failed: out of ideas" in words
    assert "flies windmap only" in words


def test_the_outage_of_a_threshold_is_that_of_the_closed_form() -> None:
    """Without path loss all links are alike; with it the mean over the pairs is set."""
    flown = load(None, method="orca")
    assert Outages(flown).snr_db(0.5) == pytest.approx(76.3523, abs=1e-3)  # as scenarios/lossy.toml has it
    lossy = load(None, ["radio.path_loss_exponent=2.0", "radio.tx_power_dbm=46"], method="orca", uavs=5)
    outages = Outages(lossy)
    assert outages.at(outages.snr_db(0.3)) == pytest.approx(0.3, rel=1e-3)


def test_a_record_of_another_version_is_refused(tmp_path) -> None:
    path = tmp_path / "frontier.json"
    with pytest.raises(record.BadInput, match="No such file"):
        record.read(path)
    path.write_text("{}")
    with pytest.raises(record.BadInput, match="no frontier"):
        record.read(path)
    made = record.FrontierRecord(record.SCHEMA + 1, "", "", 1, 2, 3, 4, [], {}, [])
    made.write(tmp_path)
    with pytest.raises(record.BadInput, match="fly it again"):
        record.read(path)


def test_every_policy_fits_every_row_of_the_leaderboard() -> None:
    assert command._MOST_FLIGHTS == grid.CONFIRMATION
    (mission,) = missions.chosen(["streams"])
    table = mission.table()
    for row in rows.shipped():
        if row.flies("streams"):
            found = policies.of_row(row, table, "streams")
            assert len({policy.name for policy in found}) == len(found)
            for policy in found[:: max(1, len(found) // 4)]:
                policy.applied_to(row).scenario(table, 1, "streams")
    assert [policy.name for policy in policies.of_row(rows.BoardRow("hjb"), table, "streams")] == [policies.OWN]
    assert [policy.name for policy in policies.of_row(rows.BoardRow("orca"), table, "streams", ["tick"])] == ["tick"]


@pytest.fixture(scope="module")
def docs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pages, with the page of a study of two sizes and two losses."""
    folder = tmp_path_factory.mktemp("frontier")
    (folder / "near.toml").write_text(SMALL)
    (folder / "docs/results").mkdir(parents=True)
    extent = Extent(
        [BoardMission("near.toml")], rows.chosen(["orca", "plan", "vasarhelyi"]), (2, 4), (0.3, 0.5), (0.9, 0.95)
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(flights, "fly", following([]))
        grid = FrontierGrid(extent, 0, None, 94001, ("event", "event-r2", "event-r4", "tick"))
        grid.fly(1, lambda _done, _total: None, Store(folder / "out")).write(folder / "out")
        main([str(folder / "out")], folder / "docs")
    return folder / "docs"


def test_every_number_of_the_page_is_that_of_the_flights(docs) -> None:
    found = record.read(docs / "results/frontier.json")
    text = (docs / "price-of-safety.md").read_text()
    orca, more, *_ = found.cells
    first, last = orca.reached[-1], more.reached[-1]
    kbit = np.array(orca.policy("event-r2").confirmation.kbit)
    assert first.kbit == pytest.approx(kbit.mean())
    ends = f"({first.kbit_low:,.1f}…{first.kbit_high:,.1f})"
    assert f"| `orca` | 30 | {kbit[:29].mean():,.1f} (" in text
    assert f"{kbit.mean():,.1f} {ends}, `event-r2` |" in text
    assert f"30 % lost: `orca` {kbit.mean():,.0f} kbit (`event-r2`)" in text
    other = next(cell for cell in found.cells_of("near.toml", 2) if (cell.row, cell.outage) == ("vasarhelyi", 0.3))
    ratio = statistics.ratio(kbit, other.policy("event-r2").confirmation.kbit)
    assert f" times `vasarhelyi` ({ratio.low:.2f}…{ratio.high:.2f})" in text
    assert f"`orca`, 2 UAVs: × {last.kbit / first.kbit:.1f}" in text
    assert "`plan`, 2 UAVs, 30 and 50 % lost: 90 % and 95 % free (best: 0/10 of the first flights, by `silent`)" in text
    assert "`plan` reaches 0 of 8 targets." in text
    flights = sum(
        len(policy.search.free) + len(policy.confirmation.free) for cell in found.cells for policy in cell.policies
    )
    assert f"{flights:,} flights of `orca`, `plan` and `vasarhelyi` on `near.toml`, with 2 and 4 UAVs" in text
    assert f"code {found.code}" in text
    named = [one.policy for cell in found.cells for one in cell.reached if one]
    assert f"`event-r2` {named.count('event-r2')}" in text
    assert "the cheapest safe one nowhere: `event` and `tick`" in text
    assert "a probability of at most 1 %, for each cell and target" in text
    tried = [
        [sum(one.search.free[:10]) for one in cell.policies[:-1] if len(one.search.free) > 2] for cell in found.cells
    ]
    falls = [second < first for each in tried for first, second in itertools.pairwise(each)]
    assert f"of {len(falls)} pairs of policies next to each other" in text
    assert f"among the first 10 in {sum(falls)}." in text
    assert "90 %: 29 flights, 0 may fail; 95 %: 59 flights, 0 may fail" in text
    assert f"a probability of only {100 * 0.99**59:.0f} %" in text
    assert max(map(len, text.partition("## Fewest bits")[0].splitlines())) < 1000
    findings = text.partition("\n1. ")[2].partition("![")[0]
    assert len(findings.split()) < 300  # one screen


def test_the_page_is_written_again_from_its_results(docs) -> None:
    before = (docs / "price-of-safety.md").read_text()
    (docs / "price-of-safety.md").unlink()
    main(["--page"], docs)
    assert (docs / "price-of-safety.md").read_text() == before
    assert "](pictures/frontier/near.png)" in before
    assert [path.name for path in (docs / "pictures/frontier").iterdir()] == ["near.png"]
    with pytest.raises(BadInput, match="or --page"):
        main([], docs)


def test_a_picture_has_a_line_for_each_controller_and_crosses_where_a_target_was_never_reached(docs) -> None:
    found = record.read(docs / "results/frontier.json")
    made = picture.draw(found, "near.toml")
    assert len(made.axes) == 4  # two targets, two sizes
    for ax in made.axes:
        lines = [line for line in ax.get_lines() if len(line.get_xdata()) == 2 and line.get_marker() != "x"]
        assert len(lines) == 3
        crosses = [line for line in ax.get_lines() if line.get_marker() == "x" and len(line.get_xdata())]
        assert [list(line.get_xdata()) for line in crosses] == [[30.0, 50.0]]  # plan
        low, high = ax.get_ylim()
        assert sum(low <= tick <= high for tick in ax.get_yticks()) >= 2
    assert [label.get_text() for label in made.axes[-1].get_xticklabels()] == ["30", "50"]
    (legend,) = made.legends
    assert [text.get_text() for text in legend.get_texts()] == ["orca", "plan", "vasarhelyi", "never reached"]


def test_a_page_of_a_target_that_nothing_reached_says_so(docs) -> None:
    found = record.read(docs / "results/frontier.json")
    silent = msgspec.structs.replace(found, cells=[cell for cell in found.cells if cell.row == "plan"])
    text = page(silent)
    assert "**Never reached**: `plan`, 2 UAVs" in text
    assert "fewest bits that show" not in text.partition("![")[0]
    picture.draw(silent, "near.toml")
