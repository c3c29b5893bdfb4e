"""The images and the compose file: their contents, and the rights of the services."""

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.commands import ended, printed
from tests.sources import BESIDE, ROOT


def stages() -> dict[str, str]:
    """Stage of the Dockerfile → what it starts from."""
    lines = re.findall(r"^FROM (\S+) AS (\S+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    return {name: base for base, name in lines}


def test_images_start_from_the_one_base_image() -> None:
    text = (ROOT / "Dockerfile").read_text()
    assert "# syntax" not in text
    assert re.findall(r"^ARG BASE_IMAGE=(.*)$", text, re.MULTILINE) == ["python:3.12-slim"]
    dependencies = {f"${{ADDED:-{image}}}-dependencies" for image in ("agent", "world", "station")}  # or `extended`
    bases = {"${BASE_IMAGE}", *stages(), *dependencies}
    assert set(stages().values()) <= bases
    assert len(re.findall(r"^FROM ", text, re.MULTILINE)) == len(stages())
    assert {"agent", "world", "station"} <= stages().keys()


def test_every_package_enters_the_images() -> None:
    for room in BESIDE:  # a link out of the build's folder would lead nowhere
        assert (ROOT / "meanflock" / room).readlink() == Path("..", room)
        assert (ROOT / room / "__init__.py").is_file()
    admitted = set(re.findall(r"^!(\S+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE))
    pins = {"constraints.txt", "constraints-learners.txt"}
    assert admitted == {"pyproject.toml", "setup.py", *pins, "LICENSE", "meanflock", *BESIDE}
    assert "COPY . .\n" in (ROOT / "Dockerfile").read_text()


FILE = ROOT / "docker-compose.yml"
OTHERS = {"BASE_IMAGE", "EXTRAS", "PACKAGES", "PIP_EXTRA_INDEX_URL", "ATEN_CPU_CAPABILITY"}  # without our prefix


def resolved(**variables: str) -> dict[str, Any]:
    """The services of the compose file as the engine's own tool resolves it; no engine has to run."""
    command = ["docker", "compose"]
    if not shutil.which("docker") or ended(*command, "version").returncode != 0:
        pytest.skip("no `docker compose` here to read docker-compose.yml with")
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("MEANFLOCK_", "COMPOSE_")) and name not in OTHERS
    }
    files = ("--env-file", os.devnull, "-f", FILE)
    return json.loads(printed(*command, *files, "config", "--format=json", env=environment | variables))["services"]


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    return resolved(MEANFLOCK_UAVS="7", MEANFLOCK_SET="seed=3", MEANFLOCK_PLUGINS="/plugins/spring.py")


def test_the_head_of_the_compose_file_lists_its_variables() -> None:
    head, _, body = FILE.read_text().partition("\nname:")
    names = {*re.findall(r"\$\{(\w+)", body), *OTHERS}
    assert [name for name in sorted(names) if name.removeprefix("MEANFLOCK") not in head] == []


def test_compose_adds_libraries_to_every_image_and_memory_to_every_process() -> None:
    wanted = {"EXTRAS": "torch", "PACKAGES": "scikit-learn", "PIP_EXTRA_INDEX_URL": "https://example.org/cpu"}
    services = resolved(**wanted, MEANFLOCK_MEMORY="2G", ATEN_CPU_CAPABILITY="avx2")
    for name, service in services.items():
        assert service["build"]["args"] == {"BASE_IMAGE": "python:3.12-slim", **wanted}, name
        if name not in MOMENTARY:
            assert int(service["deploy"]["resources"]["limits"]["memory"]) == 2 * 2**30, name
            assert service["environment"]["ATEN_CPU_CAPABILITY"] == "avx2", name


def test_the_kernels_of_torch_are_pinned_in_containers_unless_they_are_chosen(compose: dict[str, Any]) -> None:
    assert compose["agent"]["environment"].get("ATEN_CPU_CAPABILITY") is None  # empty: torch would choose


MOMENTARY = {"runs", "completed"}  # services that do one thing and end


def test_compose_gives_all_rooms_one_run_one_number_and_the_plug_ins(compose: dict[str, Any]) -> None:
    assert compose["agent"]["deploy"]["replicas"] == 7
    assert compose["worldsim"]["environment"]["MEANFLOCK_SET"] == "uavs=7 seed=3"
    rooms = [service for name, service in compose.items() if name not in MOMENTARY]
    assert len({service["environment"]["MEANFLOCK_RUN"] for service in rooms}) == 1
    for room in rooms:
        assert room["environment"]["MEANFLOCK_PLUGINS"] == "/plugins/spring.py"
        (mounted,) = (volume for volume in room["volumes"] if volume["target"] == "/plugins")
        assert (mounted["source"], mounted["read_only"]) == (str(ROOT / "examples"), True)


def test_compose_services_have_no_rights_and_no_port_but_what_they_need(compose: dict[str, Any]) -> None:
    for name, service in compose.items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert service["restart"] == "no", name
        assert {"cpus", "memory", "pids"} <= service["deploy"]["resources"]["limits"].keys(), name
        assert "privileged" not in service, name
        if name in MOMENTARY:
            assert service["network_mode"] == "none", name
        else:
            assert service["healthcheck"]["test"], name
        if name == "runs":  # root, to give a folder away, and for nothing else
            assert (service["user"], service["cap_add"]) == ("0:0", ["CHOWN"])
        else:
            assert service.get("user", "1000:1000") == "1000:1000", name
            assert "cap_add" not in service, name
    image = (ROOT / "Dockerfile").read_text()
    assert re.findall(r"^(?:USER|STOPSIGNAL) .*$", image, re.MULTILINE) == ["USER 1000:1000", "STOPSIGNAL SIGINT"]
    published = {name: service["ports"] for name, service in compose.items() if service.get("ports")}
    assert published.keys() == {"groundstation"}
    assert [(port["host_ip"], port["published"]) for port in published["groundstation"]] == [("127.0.0.1", "9876")]
    assert set(compose["agent"]["networks"]) == {"swarm"}
