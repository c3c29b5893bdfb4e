"""The command `frontier`: its record, interruption and repetition, what is never reached, and a row that cannot fly."""

import csv
import json

import pytest

from meanflock.groundstation import statistics
from meanflock.groundstation.cli import frontier as command
from meanflock.studies import study
from meanflock.studies.frontier import grid, policies, record
from meanflock.studies.frontier.outage import Outages
from meanflock.studies.leaderboard import flights, missions, rows
from meanflock.swarm.errors import EXIT_DONE, EXIT_RUN_FAILED
from meanflock.swarm.scenario import load

SHORT = ("--jobs", "1", "--quiet", "--out", "out")
RULED = ("--controllers", "orca", "plan", "--uavs", "2", "--outages", "30", "50")
RULED += ("--policies", "event", "event-r2", "event-r4", "tick", *SHORT)


@pytest.mark.usefixtures("undrawn")
def test_short_flights_give_a_table_and_files_and_are_flown_once(run, tmp_path, near, monkeypatch) -> None:
    flags = ("frontier", "--missions", near, "--controllers", "orca", "cruise", "--seeds", "2", "--outages", "30")
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
    orca, cruise = found.of(near, 25)
    assert [policy.name for policy in orca.policies] == ["event", "tick"]
    assert [policy.name for policy in cruise.policies] == [policies.SILENT]
    assert cruise.policies[0].search.kbit == [3.2, 3.2]  # the mission plan alone
    first = (tmp_path / "out/frontier.json").read_bytes()
    monkeypatch.setattr(study, "_fly", lambda *_, **__: pytest.fail("flown again"))
    assert run(*flags)[0] == EXIT_DONE
    assert (tmp_path / "out/frontier.json").read_bytes() == first


@pytest.mark.usefixtures("undrawn")
def test_the_fewest_bits_are_named_and_confirmed_on_fresh_seeds(run, tmp_path, near, ruled) -> None:
    code, out, _ = run("frontier", "--missions", near, *RULED)
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
def test_an_interrupted_search_goes_on_to_the_same_record(run, tmp_path, near, ruled, monkeypatch) -> None:
    whole = flights.fly
    assert run("frontier", "--missions", near, *RULED[:-1], "whole")[0] == EXIT_DONE
    number = len(ruled)
    ruled.clear()

    def interrupted(flown):
        if len(ruled) == number // 2:
            raise KeyboardInterrupt
        return whole(flown)

    monkeypatch.setattr(flights, "fly", interrupted)
    code, out, err = run("frontier", "--missions", near, *RULED)
    assert (code, out) == (EXIT_RUN_FAILED, "")
    assert "repeat the command" in err
    monkeypatch.setattr(flights, "fly", whole)
    assert run("frontier", "--missions", near, *RULED)[0] == EXIT_DONE
    assert len(ruled) == number
    records = [(tmp_path / folder / "frontier.json").read_bytes() for folder in ("whole", "out")]
    assert records[0] == records[1]


def test_a_row_that_cannot_fly_and_a_flight_that_fails_are_named(run, tmp_path, near, ruled, monkeypatch) -> None:
    monkeypatch.setattr(flights, "fly", lambda _: {flights.FAILED: "out of ideas"})
    flags = ("--missions", near, "--controllers", "plan", "straight", "--uavs", "2", "--outages", "3", "--seeds", "2")
    code, out, _ = run("frontier", *flags, *SHORT)
    assert code == EXIT_DONE
    found = record.read(tmp_path / "out/frontier.json")
    assert found.absent == {f"{near}, 2 UAVs, straight": "flies windmap only"}
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
    for text, says in (("{}", "no frontier"), (None, "No such file")):
        if text is not None:
            path.write_text(text)
        with pytest.raises(record.BadInput, match=says):
            record.read(path if text is not None else tmp_path / "none.json")
    made = record.Record(record.SCHEMA + 1, "", "", 1, 2, 3, 4, [], {}, [])
    made.write(tmp_path)
    with pytest.raises(record.BadInput, match="fly it again"):
        record.read(path)
    assert json.loads(path.read_text())["cells"] == []


def test_every_policy_fits_every_row_of_the_leaderboard() -> None:
    """Each resolves to a scenario; nothing is flown."""
    assert command._MOST_FLIGHTS == grid.CONFIRMATION
    (mission,) = missions.chosen(["streams"])
    table = mission.table()
    for row in rows.shipped():
        if row.flies("streams"):
            found = policies.of_row(row, table, "streams")
            assert len({policy.name for policy in found}) == len(found)
            for policy in found[:: max(1, len(found) // 4)]:
                policy.of(row).scenario(table, 1, "streams")
    assert [policy.name for policy in policies.of_row(rows.Row("hjb"), table, "streams")] == [policies.OWN]
    assert [policy.name for policy in policies.of_row(rows.Row("orca"), table, "streams", ["tick"])] == ["tick"]
