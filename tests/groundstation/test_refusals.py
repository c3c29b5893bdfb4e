"""Input that the command line refuses with one line, before it writes anything."""

import re
import socket

import pytest

from meanflock.groundstation.launch import processes
from meanflock.swarm.errors import EXIT_BAD_INPUT
from tests.groundstation.conftest import QUICK

OF_A_RUN = [
    (("--set", "wind.sgima=0.1"), "sgima"),
    (("--uavs", "many"), "--uavs"),
    (("--method", "magic"), "mfgfl-hf"),
    (("--set", "federation.leader=3"), "federation.leader"),
    (("missing.toml",), "missing.toml: No such file or directory; give a readable scenario file"),
    (("bad.toml",), "bad.toml"),
    (("--out", "bad.toml/runs"), "--out"),
    (("--uavs-per-process", "0"), "--uavs-per-process"),
    (("--realtime=-2",), "--realtime -2: how many times faster"),
    (("--metrics", "everywhere"), "--metrics everywhere: write it as PORT or HOST:PORT"),
    (("--log-format", "xml"), "json"),
    (("--no-such-flag",), "--no-such-flag"),
    (("--set", "controller.sped=2"), "controller: there is no key `sped`"),
    (("--method", "cruise", "--set", "controller.speed_m_s=-1"), "`meanflock scenario schema --method cruise` lists"),
    (("--set", "federation.options.beta=2"), "federation.options: there is no key `beta`"),
    (("--endpoint", "tcp/127.0.0.1:7447"), "leave out --endpoint"),
    (("--tls", "certs"), "leave out --tls"),
    (("--steer", "14540"), "only a flight in real time can be steered; add --realtime"),
    (("--view",), "leave out --no-record"),
    (("--web",), "--view"),
    (("--set", "faults=[{kind='kill',tick=1,uavs=[6]}]"), "UAV 6 of 0…2"),
]
ADDRESSES = ["127.0.0.1:7556", "tcp/localhost", "tcp/:7447", "tcp/127.0.0.1:99999"]
OTHERS = [
    (("plot", "."), "name the folder of a run"),
    (("view", "."), "recording"),
    *((("run", "--endpoint", address), f"{address}: write it as tcp/HOST:PORT") for address in ADDRESSES),
    (("sweep", "method=hjb,mfg", "--methods", "hjb"), "leave out --methods"),
    (("sweep", "wind.sigma=0.1,0.2", "--methods", "hjb", "--set", "method=mfg"), "leave out this --set"),
    (("sweep", "wind.sigma=0.1,0.2", "--set", "wind.sigma=3"), "leave out this --set"),
    (("sweep", "wind.sigma=0.1,0.10"), "there twice"),
    (("sweep", "wind.sigma=0.1"), "two values or more"),
    (("sweep", "wind.sigma=0.1,0.2", "--jobs", "0"), "--jobs 0"),
    (("leaderboard", "--missions", "mars"), "--missions mars: no such mission; there are paper"),
    (("leaderboard", "--controllers", "magic"), "--controllers magic: no such row or controller; rows are"),
    (("leaderboard", "--controllers", "cruise", "--missions"), "--missions: name one or more, or all"),
    (
        ("leaderboard", "--policies", "shout"),
        "shout: no such policy; there are tick, event, event-4, or all",
    ),
    (("leaderboard", "--seeds", "0"), "--seeds"),
    (("leaderboard", "--backend", "ray"), "ray"),
    (("leaderboard", "--missions", "paper", "--scheduler", "tcp://127.0.0.1:1"), "--backend dask"),
    (("leaderboard", "--plugin", "nobody.py"), "nobody.py: No such file"),
    (("leaderboard", "--missions", "paper", "--out", "bad.toml/out"), "--out bad.toml/out"),
]


@pytest.mark.parametrize(("line", "says"), [*(((*QUICK, *flags), says) for flags, says in OF_A_RUN), *OTHERS])
def test_bad_input_is_one_line_that_names_it_and_nothing_is_written(run, tmp_path, line, says) -> None:
    (tmp_path / "bad.toml").write_text("uavs = = 3")
    code, out, err = run(*line)
    assert (code, out, err.strip().count("\n")) == (EXIT_BAD_INPUT, "", 0)
    assert err.startswith("error: ")
    assert says in err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"]


@pytest.mark.parametrize(
    "flags", [("--endpoint", "tcp/TAKEN"), ("--metrics", "TAKEN"), ("--in-process", "--metrics", "TAKEN")]
)
def test_a_port_that_is_taken_is_refused_before_anything_starts(run, tmp_path, monkeypatch, flags) -> None:
    monkeypatch.setattr(processes, "Swarm", lambda *_: pytest.fail("processes were started"))
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = f"127.0.0.1:{server.getsockname()[1]}"
        code, out, err = run("run", "--uavs", "2", "--quiet", *(flag.replace("TAKEN", taken) for flag in flags))
    assert (code, out, err.count("\n")) == (EXIT_BAD_INPUT, "", 1)
    assert taken.rpartition(":")[2] in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "flags", [("--uavs", "90000"), ("--uavs", "90000", "--in-process", "--method", "hjb")], ids=["processes", "pairs"]
)
def test_a_swarm_that_does_not_fit_into_memory_is_refused_with_the_estimate(run, tmp_path, flags) -> None:
    code, _, err = run("run", "--quiet", *flags)
    assert code == EXIT_BAD_INPUT
    assert re.search(r"memory: \d+ MB for 90000 UAVs in .*process.*, \d+ MB (available|left of)", err)
    assert list(tmp_path.iterdir()) == []
