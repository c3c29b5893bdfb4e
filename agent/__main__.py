"""`python -m meanflock.agent`: a process that flies one UAV or more."""

from functools import partial
from pathlib import Path

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy reads the variables once
from meanflock.swarm.errors import needed

with needed("an agent"):
    from meanflock.agent.node import Agent
    from meanflock.launch.prefork import fork
    from meanflock.net import keys
    from meanflock.net.access import only_agent
    from meanflock.net.client import take_part
    from meanflock.net.process import Interrupted, end_with_launcher, flag, identity, main, orphaned, parser
    from meanflock.net.session import ZenohBus
    from meanflock.swarm import logs
    from meanflock.swarm.errors import BadInput
    from meanflock.swarm.wire.messages import Join


def run() -> None:
    """Be this program, with the flags in `sys.argv`."""
    options = parser("agent", "Flies one UAV, or several.", "python -m meanflock.agent --run test")
    flag(options, "--rows", "1", "most UAVs that a process flies", int, "M")
    flag(options, "--uav", "-1", "its first UAV; if negative and without --tls the world decides", int, "K")
    flag(
        options, "--count", "1", "number of processes to fork, each with --rows UAVs; from --uav on, if given", int, "N"
    )
    given = options.parse_args()
    if given.rows < 1:
        raise BadInput(f"--rows {given.rows}: an agent flies at least one UAV")
    if given.count < 1:
        raise BadInput(f"--count {given.count}: at least one")
    if given.count > 1 and given.tls and given.uav < 0:
        raise BadInput(f"--count {given.count}: with --tls name the first UAV: --uav K")
    number = fork(given.count)
    if given.count == 1:
        end_with_launcher()  # if there are several, their parent ends them
    if given.uav >= 0:
        given.uav += number * given.rows
    log_fields = logs.start(given.log_format, run=given.run, node=keys.requested_name("agent", given.uav))
    uav = only_agent(Path(given.tls)) if given.tls and given.uav < 0 else given.uav
    interrupted = Interrupted()
    certificate = identity(given.tls, keys.requested_name("agent", uav))
    take_part(
        partial(ZenohBus.client, given.endpoint, identity=certificate),
        keys.check_run(given.run),
        Join("agent", given.rows, uav),
        Agent,
        given.wait,
        interrupted.__bool__,
        orphaned,
        lambda welcome: log_fields.update(node=welcome.node, uavs=welcome.uavs),
    )


if __name__ == "__main__":
    main(run)
