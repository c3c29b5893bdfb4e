"""`python -m agent`: one process of the swarm, holding one UAV or more."""

from pathlib import Path

from agent import lean  # noqa: F401  # first: what NumPy and msgspec shall not load
from agent.node import Agent
from agent.siblings import fork
from swarm import keys, logs
from swarm.errors import BadInput
from swarm.identity import only_agent
from swarm.messages import Join
from swarm.process import Interrupted, flag, identity, main, orphaned, parser
from swarm.session import ZenohBus
from swarm.spoke import Spoke


def _run() -> None:
    options = parser("agent", "One UAV, or a few as rows of one process.", "python -m agent --run test")
    flag(options, "--rows", "1", "UAVs this process holds at the most", int)
    flag(options, "--uav", "-1", "its first UAV; the world decides where it is negative and --tls is not given", int)
    flag(options, "--count", "1", "processes to become, each with --rows UAVs; from --uav on, where that is given", int)
    given = options.parse_args()
    if given.rows < 1:
        raise BadInput(f"--rows {given.rows}: an agent holds at least one UAV")
    if given.count < 1:
        raise BadInput(f"--count {given.count}: at least one")
    if given.count > 1 and given.tls and given.uav < 0:
        raise BadInput(f"--count {given.count}: with --tls say which UAV is the first: --uav K")
    number = fork(given.count)
    if given.uav >= 0:
        given.uav += number * given.rows
    known = logs.start(given.log_format, run=given.run, node=keys.asker("agent", given.uav))
    uav = only_agent(Path(given.tls)) if given.tls and given.uav < 0 else given.uav
    interrupted = Interrupted()
    bus = ZenohBus.client(given.endpoint, given.wait, identity(given.tls, keys.asker("agent", uav)))
    try:
        spoke = Spoke(bus, keys.check_run(given.run))
        welcome = spoke.join(Join("agent", given.rows, uav), Agent, given.wait, lambda: bool(interrupted) or orphaned())
        known |= {"node": welcome.node, "uavs": welcome.uavs}
        spoke.serve(interrupted.__bool__, orphaned)
    finally:
        bus.close()


if __name__ == "__main__":
    main(_run)
