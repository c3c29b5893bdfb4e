"""Containers fly the trajectory of one process, go on whatever happens to one, and can do no more than they must."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from meanflock.launch import certs
from tests.commands import printed
from tests.compose.containers import ENDLESS, MARKS, REPOSITORY, SHORT, UAVS, USER, Compose, docker, docker_fails
from tests.polling import until

pytestmark = MARKS
HASHES = ("trajectory_sha256", "models_sha256", "payload_bits")


def flown_alone(out: Path, ways: tuple[str, ...], *arguments: object) -> dict[str, Any]:
    """The summary of `SHORT` in one process, with the arithmetic the containers choose, whatever is set here."""
    line = [sys.executable, "-m", "meanflock", "run", "--in-process", "--no-record", "--json", "--quiet"]
    line += [word for setting in (*SHORT, f"uavs={UAVS}", *ways) for word in ("--set", setting)]
    env = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    return json.loads(printed(*line, *arguments, "--out", out, env=env, cwd=REPOSITORY))


def test_containers_fly_the_trajectory_of_one_process_and_leave_the_run_folder(compose, tmp_path) -> None:
    ways = ("federation.fragment=1", "radio.target_snr_db=76")  # a model goes to the leader and back in four fragments
    compose.up(" ".join([*SHORT, *ways]))
    summary = compose.finished()
    expected = flown_alone(tmp_path / "alone", ways)
    assert [summary[name] for name in HASHES] == [expected[name] for name in HASHES]
    traffic = summary["radio"]["traffic"]
    assert traffic["broadcast"]["transmissions"] == 4 * summary["rounds"] > 0
    assert all(traffic[kind]["outages"] for kind in ("uplink", "broadcast"))
    files = {"scenario.toml", "summary.json", "timeseries.parquet", "rounds.parquet", "events.jsonl", "recording.rrd"}
    assert {path.name for path in compose.folder.iterdir()} == files


@pytest.mark.parametrize(("mission", "way"), [("radio-mast", "seed=8"), ("mast", "vehicle.model=quadrotor")])
def test_containers_fly_with_a_mast_and_go_on_when_it_is_lost(mission: str, way: str, compose, tmp_path) -> None:
    mast = REPOSITORY / "scenarios" / f"{mission}.toml"
    ways = ("federation.period=20", 'faults=[{kind="kill",tick=50,stations=[0]}]', way)
    compose.up(" ".join([*SHORT, *ways]), MEANFLOCK_SCENARIO=f"scenarios/{mission}.toml")
    summary = compose.finished()
    expected = flown_alone(tmp_path / "alone", ways, mast)
    assert [summary[name] for name in HASHES] == [expected[name] for name in HASHES]
    assert summary["radio"]["links"] == expected["radio"]["links"]
    receivers = {target for source, target, *_ in summary["radio"]["links"] if source < UAVS}
    assert {UAVS, 0} <= receivers  # the station, and then the UAV that leads


def test_long_models_of_a_mounted_file_are_those_of_one_process_and_an_idle_leader_ends(compose, tmp_path) -> None:
    file = REPOSITORY / "tests" / "agent" / "large_model.py"
    ways = ("method=large", "federation.topology=neighbours", "federation.fragment=3")
    mounted = {"MEANFLOCK_PLUGIN_DIR": str(file.parent), "MEANFLOCK_PLUGINS": f"/plugins/{file.name}"}
    compose.up(" ".join([*SHORT, *ways]), **mounted)
    compose.ended(compose.container("leader"))
    assert "no leader is needed" in compose("logs", "leader")
    summary = compose.finished()
    expected = flown_alone(tmp_path / "alone", ways, "--plugin", file)
    assert [summary[name] for name in HASHES] == [expected[name] for name in HASHES]
    assert summary["rounds"] > 0
    assert summary["radio"]["traffic"]["uplink"]["transmissions"] > summary["rounds"] * UAVS  # models go in fragments
    assert (summary["lost"], summary["dropped_messages"]) == (0, {})


def test_a_learner_of_a_mounted_file_learns_what_it_learns_in_one_process(compose, tmp_path) -> None:
    file = REPOSITORY / "tests" / "agent" / "learning" / "lines.py"
    ways = ("uavs=2", "method=orca", "training.learner=line", "training.fit_s=1.1", "training.spread=0.5")
    mounted = {"MEANFLOCK_PLUGIN_DIR": str(file.parent), "MEANFLOCK_PLUGINS": f"/plugins/{file.name}"}
    compose.up(" ".join([*SHORT, *ways]), MEANFLOCK_UAVS="2", **mounted)
    summary = compose.finished()
    expected = flown_alone(tmp_path / "alone", ways, "--plugin", file)
    assert [summary[name] for name in HASHES] == [expected[name] for name in HASHES]
    assert summary["rounds"] > 0
    assert "loss" in summary["diagnostics"]
    assert (summary["lost"], summary["dropped_messages"]) == (0, {})


def test_under_tls_every_container_has_its_own_key_and_a_foreign_certificate_is_kept_out(compose, tmp_path) -> None:
    good, foreign = tmp_path / "certs", tmp_path / "foreign"
    certs.init(good, UAVS)
    certs.init(foreign, UAVS)
    compose.secure(good)
    agents = [f"agent-{uav}" for uav in range(UAVS)]
    compose.up(" ".join(SHORT), "worldsim", "leader", "groundstation", *agents[:-1])  # the flight waits for the last
    own = {"worldsim": "world", "groundstation": "station"}
    assert set(compose.containers().values()) == {"worldsim", "leader", "groundstation", *agents[:-1]}
    for container, service in compose.containers().items():
        name = own.get(service, service)
        assert docker("exec", container, "ls", "/certs").split() == sorted(["ca.pem", f"{name}.key", f"{name}.pem"])
    mounts = {"ca.pem": good, f"{agents[-1]}.pem": foreign, f"{agents[-1]}.key": foreign}
    line = ["run", "--rm", "--network", f"{compose.name}_swarm", "--user", str(USER)]
    line += [word for file, folder in mounts.items() for word in ("-v", f"{folder / file}:/certs/{file}:ro")]
    line += ["meanflock-agent:local", "meanflock.agent", "--endpoint", "tls/worldsim:7447", "--run", compose.name]
    line += ["--tls", "/certs", "--wait", "3"]
    assert f"refuses /certs/{agents[-1]}.pem" in docker_fails(1, *line)
    compose.up(" ".join(SHORT), agents[-1])
    summary = compose.finished()
    assert summary["trajectory_sha256"] == flown_alone(tmp_path / "alone", ())["trajectory_sha256"]
    assert summary["dropped_messages"] == {}


def test_the_world_of_containers_cannot_be_steered_and_says_why() -> None:
    line = ["meanflock.worldsim", "--endpoint", "tcp/127.0.0.1:7447", "--realtime", "1", "--steer", "0.0.0.0:14540"]
    error = docker_fails(2, "run", "--rm", "--network", "none", "meanflock-world:local", *line)
    assert error == "error: pymavlink is not installed, and --steer needs it: pip install 'meanflock[mavlink]'\n"


def test_containers_are_healthy_can_do_no_more_than_they_must_and_end_when_they_are_asked(compose: Compose) -> None:
    compose.up(ENDLESS)
    compose.flying(20_000)
    for container, service in compose.containers().items():
        until(lambda c=container: compose.state(c)["Health"]["Status"] == "healthy", f"{container} to be healthy")
        assert int(docker("exec", container, "id", "-u")) == USER
        assert "Read-only" in docker_fails(1, "exec", container, "touch", "/app/new")
        docker("exec", container, "touch", "/tmp/new")
        powers = docker("exec", container, "grep", "-E", "Cap(Inh|Prm|Eff|Bnd)|NoNewPrivs", "/proc/self/status")
        assert [line.split()[1].lstrip("0") for line in powers.splitlines()] == ["", "", "", "", "1"]
        limits = compose.inspect(container, "HostConfig")
        memory_mb = {"worldsim": 512, "groundstation": 1024}.get(service, 256)
        assert (limits["Memory"], limits["Privileged"]) == (memory_mb * 2**20, False)
        assert limits["NanoCpus"] > 0
        assert limits["PidsLimit"] > 0
        assert compose.inspect(container, "Config")["StopSignal"] == "SIGINT"
    docker("stop", compose.container("agent", 2))
    assert compose.state(compose.container("agent", 2))["ExitCode"] == 0  # 137: had to be killed
    compose.event("lost")
    docker("stop", compose.container("worldsim"))
    for container, service in compose.containers().items():
        compose.ended(container, code=int(service == "worldsim"))  # 1: interrupted
    assert compose.summary()["lost"] == 1
