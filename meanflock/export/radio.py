"""The radio of a run as a table of its uploads, which other engines of federated learning can replay."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from meanflock.federation.plan import plan_of
from meanflock.results import flown_plugins
from meanflock.results.flown import FlightSoFar
from meanflock.results.rounds_table import stored_rounds
from meanflock.results.run_folder import EVENTS, SCENARIO
from meanflock.swarm import durable, scenario
from meanflock.swarm.errors import BadInput

FORMAT = "meanflock-radio 1"


def write_radio(flight: FlightSoFar, path: Path, show: Callable[[int, int], object]) -> None:
    """Write what became of every upload of a run: round, UAV, `arrived`, the share that was there when the round was
    averaged, `delay_s` from the opening of the round to its last part, null if nothing arrived, and bits of the model.

    Raises:
        BadInput: the run has no rounds, its files are damaged, or a plug-in of it is not loaded.
    """
    folder = flight.folder
    flown = scenario.load(folder / SCENARIO)
    flown_plugins.check(folder, flown, f"meanflock export {folder} --radio {path}")
    hops = plan_of(flown).hops
    rounds = stored_rounds(folder / EVENTS)
    if not hops or not rounds:
        raise BadInput(f"{folder}: no model was uploaded in this run; fly a method that shares one")
    bits = hops[0].codec.count * hops[0].codec.bits
    uploads: list[dict[str, Any]] = []
    for ended in rounds:
        for uav, share, delay_s in zip(ended.sent, ended.shares, ended.delays_s, strict=True):
            uploads.append({"round": ended.number, "uav": uav, "arrived": share, "delay_s": delay_s, "bits": bits})
        show(ended.tick, flight.ticks)
    head = {"format": FORMAT, "uavs": flown.uavs, "round_s": plan_of(flown).period_ticks * flown.dt}
    durable.put(path, (json.dumps(head | {"uploads": uploads}) + "\n").encode())
