"""What the command line refuses: in one line that says so, and nothing is left behind."""

import os
import re
import socket

import pytest

from meanflock.swarm.errors import (
    EXIT_BAD_INPUT,
)
from tests.groundstation.conftest import QUICK


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--set", "wind.sgima=0.1"), "sgima"),
        (("--set", "wind.sigma=strong"), "wind.sigma"),
        (("--set", "wind.sigma=-1"), "wind.sigma"),
        (("--set", "wind.sigma=nan"), "wind.sigma"),
        (("--set", "radio.rice_chi=0"), "radio.rice_chi"),
        (("--set", "nonsense"), "key=value"),
        (("--uavs", "0"), "uavs"),
        (("--uavs", "-3"), "uavs"),
        (("--uavs", "many"), "--uavs"),
        (("--seed", "-1"), "seed"),
        (("--duration", "nan"), "duration"),
        (("--method", "magic"), "mfgfl-hf"),
        (("--set", "federation.leader=3"), "federation.leader"),
        (("--set", "federation.period=0"), "federation.period"),
        (("missing.toml",), "missing.toml: No such file or directory; give a readable scenario file"),
        (("--faults", "missing.toml"), "missing.toml: No such file or directory; give a readable fault script"),
        (("--uavs-per-process", "0"), "--uavs-per-process"),
        (("--realtime", "0"), "--realtime"),
        (("--realtime=-2",), "--realtime -2: how many times faster"),
        (("--realtime", "-.5"), "--realtime -.5: how many times faster"),
        (("--realtime", "nan"), "--realtime nan"),
        (("--metrics", "everywhere"), "--metrics everywhere: write it as PORT or HOST:PORT"),
        (("--log-format", "xml"), "json"),
        (("--no-such-flag",), "--no-such-flag"),
        (("--set", "controller.sped=2"), "controller: there is no key `sped`"),
        (("--set", "federation.options.beta=2"), "federation.options: there is no key `beta`"),
    ],
)
def test_bad_input_is_one_line_that_names_it_and_nothing_is_written(run, tmp_path, flags, says) -> None:
    code, out, err = run(*QUICK, *flags)
    assert code == EXIT_BAD_INPUT
    assert out == ""
    assert err.startswith("error: ")
    assert err.strip().count("\n") == 0
    assert says in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("endpoint", "says"),
    [
        ("127.0.0.1:7556", "127.0.0.1:7556: write it as tcp/HOST:PORT, for example tcp/127.0.0.1:"),
        ("tcp/localhost", "tcp/localhost: write it as tcp/HOST:PORT"),
        ("tcp/127.0.0.1:99999", "99999: write it as tcp/HOST:PORT"),
    ],
)
def test_an_endpoint_that_is_none_is_refused_before_anything_starts(run, tmp_path, endpoint, says) -> None:
    code, out, err = run("run", "--uavs", "3", "--quiet", "--endpoint", endpoint)
    assert (code, out, err.count("\n")) == (EXIT_BAD_INPUT, "", 1)
    assert says in err
    assert list(tmp_path.iterdir()) == []


def test_a_scenario_file_that_is_no_toml_or_not_readable(run, tmp_path) -> None:
    (tmp_path / "bad.toml").write_text("uavs = = 3")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name in ("bad.toml", "binary.toml", "."):
        code, _, err = run(*QUICK, name)
        assert code == EXIT_BAD_INPUT
        assert err.strip().count("\n") == 0
    assert not (tmp_path / "runs").exists()


def test_an_output_folder_that_cannot_be_written(run, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    code, _, err = run(*QUICK, "--out", "file/runs")
    assert code == EXIT_BAD_INPUT
    assert "--out" in err
    assert os.listdir(tmp_path) == ["file"]


def test_an_occupied_port_leaves_nothing_behind(run, tmp_path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        code, _, err = run("run", "--quiet", "--no-record", "--uavs", "2", "--endpoint", f"tcp/127.0.0.1:{port}")
    assert code == EXIT_BAD_INPUT
    assert str(port) in err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "flags", [("--uavs", "90000"), ("--uavs", "90000", "--in-process", "--method", "hjb")], ids=["processes", "pairs"]
)
def test_a_swarm_that_does_not_fit_into_memory_is_refused_with_the_estimate(run, tmp_path, flags) -> None:
    code, _, err = run("run", "--quiet", *flags)
    assert code == EXIT_BAD_INPUT
    assert re.search(r"memory: \d+ MB for 90000 UAVs in .*process.*, \d+ MB (available|left of)", err)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("flags", "unused"),
    [
        (("--in-process", "--endpoint", "tcp/127.0.0.1:7447"), "--endpoint"),
        (("--in-process", "--tls", "certs"), "--tls"),
        (("--in-process", "--no-record", "--view"), "--no-record"),
    ],
)
def test_an_option_that_would_do_nothing_is_bad_input(flags, unused, run, tmp_path) -> None:
    code, _, err = run("run", *flags, "--uavs", "2", "--duration", "2")
    assert (code, err.count("\n")) == (EXIT_BAD_INPUT, 1)
    assert f"leave out {unused}" in err
    assert list(tmp_path.iterdir()) == []
