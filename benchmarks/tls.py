"""Cost of encryption and certificates for a swarm of processes."""

import tempfile
from pathlib import Path

from benchmarks.figure import Effort, Figure, Outcome, Say
from benchmarks.processes import COMMAND, BenchmarkFailed, captured, meanflock

TITLE = "With TLS"
ABOUT = (
    "`meanflock run --tls` in turns with the same run without: 25 agent processes, mutual TLS on every link, and the "
    "access rules that come with it."
)
UAVS = 25


def run(effort: Effort, say: Say) -> Outcome:
    """With and without, in turns."""
    output, _, _ = captured([*COMMAND, "run", "--help"], 30.0)
    if "--tls" not in output:
        raise BenchmarkFailed("meanflock run has no --tls")
    flags = ("--uavs", str(UAVS), "--set", "stop=duration", "--duration", str(effort.choose(400, 60) / 10))
    ms: dict[str, list[float]] = {"plain": [], "tls": []}
    with tempfile.TemporaryDirectory(prefix="meanflock-bench-") as folder:
        certificates = str(Path(folder) / "certs")
        _, output, code = captured([*COMMAND, "certs", "init", certificates, "--uavs", str(UAVS)], 60.0)
        if code:
            raise BenchmarkFailed(f"meanflock certs init: {output.strip()}")
        for repeat in range(effort.choose(3, 1)):
            for name, more in (("plain", ()), ("tls", ("--tls", certificates))):
                say(f"{name}, {repeat + 1}")
                summary, _ = meanflock(*flags, *more)
                ms[name].append(summary["wall_time_s"] / summary["ticks"] * 1e3)
    plain = Figure("tick over TCP", "ms/tick", ms["plain"])
    return Outcome(
        [
            Figure("tick over TLS", "ms/tick", ms["tls"], floor=plain),
            plain,
            Figure("ticks a second over TLS", "1/s", [1e3 / t for t in ms["tls"]], "higher"),
        ]
    )
