"""`list`, `show` and `diff`: stored runs as tables, JSON and a page; damaged and unfinished ones."""

import json
import re
import shutil
from html import unescape
from pathlib import Path
from typing import Any

import pytest

import meanflock as mf
from meanflock.cli.command import main
from meanflock.cli.tables import empty, print_table
from meanflock.results.quantities import SUMMARY, VARYING
from meanflock.results.run_folder import CHECKPOINT
from meanflock.results.stored_run import runs_in
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.groundstation.conftest import QUICK

SUMMARY_OF_1_0_0 = Path(__file__).parents[1] / "golden/summary-1.0.0.json"
HOSTILE = "<script>alert('&')</script>\x1b[31m"


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two runs of one mission and controller, and one of another."""
    folder = tmp_path_factory.mktemp("flown")
    for flags in (("--seed", "1"), ("--seed", "2", "--set", "wind.sigma=0.2"), ("swap", "--method", "plan")):
        assert main([*QUICK, *flags, "--out", str(folder)]) == EXIT_DONE
    return folder


@pytest.fixture
def runs(flown: Path, run, tmp_path: Path) -> Path:
    """A copy of that folder in the working folder."""
    shutil.copytree(flown, tmp_path / "runs")
    return Path("runs")


def one(runs: Path, end: str) -> Path:
    (found,) = runs.glob(f"*{end}")
    return found


def spoil(run: Path, **fields: Any) -> None:
    path = run / "summary.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | fields))


def test_a_list_has_what_was_flown_and_what_came_of_it(run, runs, monkeypatch) -> None:
    records = {record["run_id"][16:]: record for record in json.loads(run("list", "--json")[1])}
    assert {name: (each["mission"], each["uavs"], each["seed"], each["status"]) for name, each in records.items()} == {
        "mfgfl-hf-s1": ("paper", 3, 1, "finished"),
        "mfgfl-hf-s2": ("paper", 3, 2, "finished"),
        "plan-s1": ("swap", 3, 1, "finished"),
    }
    assert records["mfgfl-hf-s2"]["changed"] == {"duration": 2.0, "wind.sigma": 0.2}
    summary = json.loads((one(runs, "s2") / "summary.json").read_text())
    assert records["mfgfl-hf-s2"]["payload_bits"] == summary["payload_bits"]["total"]
    for columns, headings in ((80, 6), (140, 9)):
        monkeypatch.setenv("COLUMNS", str(columns))
        code, out, _ = run("list", "runs")
        assert (code, len(out.splitlines()), max(map(len, out.splitlines())) <= columns) == (EXIT_DONE, 5, True)
        assert len(out.splitlines()[0].split()) == headings
        assert "swap +1" in out
    Path("empty").mkdir()
    assert run("list", "empty", "--json")[:2] == (EXIT_DONE, "[]\n")


def test_hits_of_obstacles_the_ground_and_limits_are_told_after_a_flight_and_by_show(run) -> None:
    Path("down.toml").write_text(
        """duration = 10
uavs = 2
method = "cruise"
start = { positions = [[40, 0, 9], [0, 40, 9]] }
space = { dimensions = 3, floor = 3 }
obstacles = [{ centre = [30, 0], radius = 3, height = 20 }]
faults = [{ kind = "gust", tick = 5, duration_s = 3.0, uavs = [1], acceleration = [0, 0, -30] }]
"""
    )
    code, told, _ = run("run", "down.toml", "--in-process", "--no-record", "--quiet")
    assert code == EXIT_DONE
    rows = " ".join(re.sub("[│ ]+", " ", told).split())
    assert (
        "obstacle hits 1 of a UAV, each obstacle once grounded 1 UAVs, before they arrived altitude violations 1"
        in rows
    )
    words = " ".join(run("show", "latest")[1].split())
    assert (
        "UAVs flew into obstacles 1 time. 1 UAV came down to the ground on the way. "
        "UAVs left the limits of altitude 1 time."
    ) in words


def test_a_patrol_is_listed_and_shown_with_its_waypoints_and_batteries(run, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    flight = ("run", "patrol", "--in-process", "--no-record", "--quiet")
    rows = " ".join(re.sub("[│ ]+", " ", run(*flight)[1]).split())
    assert "arrived 2 of 5 0 lost travel time" in rows
    counts = "landed for good 5 UAVs, arrived or not waypoints reached 14 turned back 5 UAVs, low battery speed,"
    assert counts in rows
    words = " ".join(run("show", "latest")[1].split())
    for part in (
        "5 UAVs under cruise+orca in patrol, seed 1,",
        "2 of 5 UAVs arrived, after 80.2 s on average; 5 landed for good, whether they had arrived or not.",
        "The UAVs reached 14 waypoints. 5 UAVs turned back with a low battery. The UAVs sent",
    ):
        assert part in words
    assert run(*flight, "--duration", "5")[0] == EXIT_DONE
    (first, *_), (second, *_) = (line.split() for line in run("list")[1].splitlines()[2:])
    assert first.endswith("-patrol-s1")
    listed, differ = run("list")[1], run("diff", f"runs/{second}", f"runs/{first}")[1]
    assert max(map(len, (listed + differ).splitlines())) <= 80
    assert [line.split()[1:4] for line in listed.splitlines()[2:]] == [
        ["cruise+orca", "patrol", "+1"],
        ["cruise+orca", "patrol", "5"],
    ]
    titles = [line for line in differ.splitlines() if line.startswith("Group ")]
    assert titles == ["Group patrol", "Group followers"]
    assert sum(line.startswith("energy_mean_J ") for line in differ.splitlines()) == 3
    Path("runs", first, "summary.json").unlink()  # as of a flight that did not finish
    assert run("show", f"runs/{first}")[1].startswith(f"runs/{first}\n5 UAVs under cruise+orca in patrol +1, seed 1,")


def test_a_run_of_several_controllers_is_called_as_its_file(run, tmp_path) -> None:
    path = tmp_path / "two of mine.toml"
    path.write_text(run("scenario", "show", "patrol")[1])
    assert run("run", str(path), "--in-process", "--no-record", "--quiet", "--duration", "1")[0] == EXIT_DONE
    (folder,) = Path("runs").iterdir()
    assert folder.name.endswith("-two-of-mine-s1")


def test_a_run_is_called_by_the_scenario_that_was_flown(run, tmp_path) -> None:
    text = Path(tmp_path / "my wall.v2.toml")
    text.write_text("duration = 1.0\nuavs = 3\n[wind]\nsigma = 0.3\n")

    def missions() -> list[str]:
        """Of the runs, the first one first, as `show` names them."""
        folders = sorted(Path("runs").iterdir(), key=lambda folder: (folder / "events.jsonl").stat().st_mtime_ns)
        return [run("show", str(folder))[1].split("under ")[1].split(", seed")[0] for folder in folders]

    assert run(*QUICK[:1], str(text), *QUICK[1:])[0] == EXIT_DONE
    (first,) = Path("runs").iterdir()
    assert run("run", f"{first}/scenario.toml", "--in-process", "--no-record", "--quiet")[0] == EXIT_DONE
    assert run("run", "swap", "--in-process", "--no-record", "--quiet", "--duration", "1")[0] == EXIT_DONE
    mf.fly(text, method="cruise", out="runs")
    mf.Stepped("lossy", duration=1.0, out="runs").finish()
    mf.fly(mf.Scenario.load(text), out="runs")
    own = "my-wall-v2"
    assert missions() == [
        f"mfgfl-hf in {own}",
        f"mfgfl-hf in {own}",
        "mfgfl-hf in swap +1",
        f"cruise in {own}",
        "stepped in lossy +1",
        "mfgfl-hf in paper +2",
    ]
    text.rename(tmp_path / "a scenario of mine that has a very long name.toml")
    assert run("run", "a scenario of mine that has a very long name.toml", *QUICK[1:])[0] == EXIT_DONE
    listed = run("list")[1].splitlines()
    assert max(map(len, listed)) <= 80
    assert [line.split()[-1] for line in listed].count("sent") == 1  # one table
    assert "a-scenario-" in listed[2]
    (first / "summary.json").unlink()  # as of a flight that did not finish
    assert f" {own} " in run("list")[1]
    assert run("list", "--html", "page.html")[0] == EXIT_DONE
    assert f"· {own} ·" in Path("page.html").read_text()
    records = {record["folder"]: record for record in json.loads(run("list", "--json")[1])}
    record = records[str(first)]
    assert (record["mission"], record["changed"]) == (own, {"duration": 2.0, "wind.sigma": 0.3})
    (first / "scenario.toml").write_text((first / "scenario.toml").read_text().split("\n", 1)[1])  # of an older version
    assert missions()[0] == "mfgfl-hf in paper +2"


def test_a_table_that_is_wider_than_the_terminal_is_divided_into_parts(monkeypatch, capsys) -> None:
    table = empty("title", "caption")
    table.add_column("name", no_wrap=True)
    for number in range(12):
        table.add_column(f"a_long_heading_{number}", justify="right", no_wrap=True)
    for row in ("first", "second"):
        table.add_row(row, *(f"{row}-number-{number}" for number in range(12)))
    monkeypatch.setenv("COLUMNS", "60")
    print_table(table)
    parts = capsys.readouterr().out.split("\n\n")
    assert max(len(line) for part in parts for line in part.splitlines()) <= 80
    assert [[line.split()[0] for line in part.splitlines()] for part in parts[1:-1]] == [
        ["name", "─" * len(part.splitlines()[1]), "first", "second"] for part in parts[1:-1]
    ]
    words = " ".join(parts).split()
    assert (words[0], words[-1]) == ("title", "caption")
    for number in range(12):
        assert [words.count(f"{each}{number}") for each in ("a_long_heading_", "first-number-")] == [1, 1]
    monkeypatch.setenv("COLUMNS", "300")
    print_table(table)
    assert len(capsys.readouterr().out.splitlines()) == 6


@pytest.mark.parametrize("name", ["logistic-regression-of-mine", "two words and some more of them"])
def test_a_heading_is_never_broken_within_a_word(name, monkeypatch, capsys) -> None:
    table = empty()
    for heading in ("controller.\ninformativeness", "training.\nlearner"):
        table.add_column(heading, overflow="fold")
    table.add_column("method", no_wrap=True)
    for _ in range(5):
        table.add_column("time", justify="right", no_wrap=True)
    table.add_row("1", name, "MFGFL-HF", *["12.345"] * 5)
    monkeypatch.setenv("COLUMNS", "80")
    print_table(table)
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    assert {"informativeness", "learner"} <= {*printed.split()}
    assert "".join(re.findall("[a-z-]", printed.split("─")[-1].replace("MFGFL-HF", ""))) == name.replace(" ", "")


def test_a_long_key_is_broken_after_a_mark_in_it(monkeypatch, capsys) -> None:
    keys = ["groups.couriers.controller.horizon_s", "radio.latency_slots_mean_theory_of_all_links", "wind.sigma"]
    table = empty()
    for heading in ("key", "value", "default"):
        table.add_column(heading, overflow="fold")
    for key in keys:
        table.add_row(key, "v" * 24, "d" * 24)
    monkeypatch.setenv("COLUMNS", "60")
    print_table(table)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines[2:]] == [
        *("groups.couriers.controller.", "horizon_s", "radio.latency_slots_mean_", "theory_of_all_links", "wind.sigma")
    ]


@pytest.mark.parametrize("numbers", [2, 8])
def test_a_long_name_goes_on_after_a_plus_and_a_long_word_folds_so_that_the_table_fits(
    numbers, monkeypatch, capsys
) -> None:
    names = ["cruise", "orca", "bvc", "potential-field", "olfati-saber", "vasarhelyi", "mfgfl-hf", "offline"]
    table = empty()
    table.add_column("run", no_wrap=True)
    table.add_column("method", no_wrap=True)
    table.add_column("group", overflow="fold")
    for number in range(numbers):
        table.add_column(f"number_{number}", justify="right", no_wrap=True)
    table.add_row("20261128-100000-groups-s1", "+".join(names), "group-" * 5 + "32", *["123.4"] * numbers)
    table.add_row("20261128-100000-paper-s1", "cruise+orca", "two", *["5"] * numbers)
    monkeypatch.setenv("COLUMNS", "80")
    print_table(table)
    parts = capsys.readouterr().out.split("\n\n")
    assert max(len(line) for part in parts for line in part.splitlines()) <= 80
    assert len(parts) == (1 if numbers == 2 else 4)
    for part in parts:
        words = part.split()
        for name in (*(f"{name}+" for name in names[3:5]), "vasarhelyi+", "mfgfl-hf+offline", "cruise+orca+bvc+"):
            assert name in words
        assert {"cruise+orca", "20261128-100000-groups-s1", "two"} <= {*words}
    folded = [line.split()[2] for line in parts[0].splitlines() if "groups-s1" in line]
    assert len(folded[0]) >= 12
    monkeypatch.setenv("COLUMNS", "300")
    print_table(table)
    assert "+".join(names) in capsys.readouterr().out


def test_show_has_the_changed_keys_the_summary_and_the_files(run, runs) -> None:
    folder = one(runs, "s2")
    shown = json.loads(run("show", str(folder), "--json")[1])
    assert shown["keys"]["wind.sigma"] == {"value": 0.2, "default": 0.1}
    assert shown["keys"].keys() == {"duration", "seed", "uavs", "wind.sigma"}
    assert shown["summary"] == json.loads((folder / "summary.json").read_text())
    assert shown["files"] == {path.name: path.stat().st_size for path in folder.iterdir()}
    code, out, _ = run("show", str(folder))
    assert code == EXIT_DONE
    for part in ("3 UAVs under mfgfl-hf in paper +2, seed 2", "0 of 3 UAVs arrived", "wind.sigma", *shown["files"]):
        assert part in " ".join(out.split())


def test_diff_has_the_keys_and_figures_that_differ_and_no_others(run, runs) -> None:
    first, second = one(runs, "hf-s1"), one(runs, "hf-s2")
    found = json.loads(run("diff", str(first), str(second), "--json")[1])
    assert found["keys"] == {"seed": {"a": 1, "b": 2}, "wind.sigma": {"a": 0.1, "b": 0.2}}
    a, b = (json.loads((folder / "summary.json").read_text()) for folder in (first, second))
    plain = [field.key for field in SUMMARY if isinstance(a.get(field.key), int | float)]
    others = VARYING | {"seed"}
    assert {key for key in found["figures"] if "." not in key} == {key for key in plain if a[key] != b[key]} - others
    assert found["figures"]["phi_A"]["change"] == b["phi_A"] - a["phi_A"]
    assert (found["same_flight"], found["figures"]["phi_A"]["unit"]) == (False, "m/s")
    code, out, _ = run("diff", str(first), str(second))
    assert (code, "wind.sigma" in out, "phi_A" in out, max(map(len, out.splitlines())) <= 80) == (0, True, True, True)
    same = run("diff", str(first), str(first))[1]
    assert "Keys that differ: none" in same
    assert "Both flights are bit-identical." in same


@pytest.mark.parametrize(
    ("damage", "status", "says"),
    [
        (lambda run: (run / "summary.json").write_text("{"), "damaged", "damaged: not JSON"),
        (lambda run: (run / "summary.json").write_text("[]"), "damaged", "Expected `object`, got `array`"),
        (lambda run: spoil(run, schema=2, version="9.9"), "damaged", "of version 2, written by meanflock 9.9"),
        (lambda run: spoil(run, rounds=HOSTILE), "damaged", "Expected `int | float | null`, got `str` - at `$.rounds`"),
        (lambda run: (run / "scenario.toml").write_text("="), "damaged", "not TOML"),
        (lambda run: (run / "scenario.toml").unlink(), "damaged", "No such file"),
        (
            lambda run: (run / "summary.json").unlink(),
            "unfinished",
            "has not finished; there is no checkpoint to resume from",
        ),
        (lambda run: (run / CHECKPOINT).write_bytes(b""), "interrupted", "`meanflock resume"),
    ],
)
def test_a_run_that_cannot_be_compared_is_listed_and_refused(damage, status: str, says: str, run, runs) -> None:
    good, bad = one(runs, "hf-s1"), one(runs, "hf-s2")
    damage(bad)
    assert {record["status"] for record in json.loads(run("list", "--json")[1])} == {"finished", status}
    assert run("list")[0] == run("list", "--html", "page.html")[0] == EXIT_DONE
    assert run("show", str(bad))[0] == (EXIT_BAD_INPUT if status == "damaged" else EXIT_DONE)
    code, out, err = run("diff", str(good), str(bad))
    assert (code, out, err.count("\n"), says in err, "\x1b" in err) == (EXIT_BAD_INPUT, "", 1, True, False)


def test_a_run_of_version_1_0_0_is_read_though_its_summary_lacks_later_fields(run, runs) -> None:
    new, old = one(runs, "hf-s2"), one(runs, "hf-s1")
    record = json.loads(SUMMARY_OF_1_0_0.read_text())
    assert not {"collisions_at_ticks", "diagnostics_mean"} & record.keys()
    shutil.copy(SUMMARY_OF_1_0_0, old / "summary.json")
    assert {each["status"] for each in json.loads(run("list", "--json")[1])} == {"finished"}
    assert json.loads(run("show", str(old), "--json")[1])["summary"] == record
    assert run("show", str(old))[0] == run("list", "--html", "page.html")[0] == EXIT_DONE
    figures = json.loads(run("diff", str(old), str(new), "--json")[1])["figures"]
    assert figures["collisions_at_ticks"] == {"unit": "pairs", "a": None, "b": 0, "change": None}
    assert mf.open(old).summary == record
    del record["phi_A"]  # which every version writes
    (old / "summary.json").write_text(json.dumps(record))
    assert "missing required field `phi_A`" in run("show", str(old))[2]


def test_the_page_has_a_picture_of_each_run_escapes_all_text_and_loads_nothing(run, runs) -> None:
    spoil(one(runs, "hf-s1"), method=HOSTILE)
    one(runs, "plan-s1").rename(runs / HOSTILE.replace("/", "-"))
    code, out, _ = run("list", "--html", "page.html")
    page = Path("page.html").read_text(encoding="utf-8")
    assert (code, out, page.count("<svg"), page.count("<article")) == (EXIT_DONE, "page.html\n", 3, 3)
    assert "default-src 'none'" in page
    assert not re.findall(r"<(?:script|img|link|iframe)|(?:src|srcset)\s*=|url\(|@import|https?:|\x1b", page)
    assert "<script>alert('&')</script>\\x1b[31m" in unescape(page)
    assert set(re.findall(r"href='([^']*)'", page)) == {f"#run-{number}" for number in range(3)}
    assert [run.status for run in runs_in(runs)] == ["finished"] * 3
