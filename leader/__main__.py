"""`python -m meanflock.leader`: the process that averages the models."""

import logging
from functools import partial

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy reads the variables once
from meanflock.swarm.errors import needed

with needed("the leader"):
    from meanflock.leader.node import Leader
    from meanflock.net import keys
    from meanflock.net.access import LEADER
    from meanflock.net.client import take_part
    from meanflock.net.process import Interrupted, end_with_launcher, identity, main, orphaned, parser
    from meanflock.net.session import ZenohBus
    from meanflock.swarm import logs
    from meanflock.swarm.errors import Refused
    from meanflock.swarm.wire.messages import Join


def run() -> None:
    """Be this program, with the flags in `sys.argv`."""
    given = parser("leader", "Averages the models of the UAVs.", "python -m meanflock.leader --run test").parse_args()
    log_fields = logs.start(given.log_format, run=given.run, node=LEADER)
    interrupted = Interrupted()
    end_with_launcher()
    try:
        take_part(
            partial(ZenohBus.client, given.endpoint, identity=identity(given.tls, LEADER)),
            keys.check_run(given.run),
            Join("leader", 0),
            Leader,
            given.wait,
            interrupted.__bool__,
            orphaned,
            lambda welcome: log_fields.update(node=welcome.node),
        )
    except Refused as refused:
        if not refused.over:
            raise
        logs.show(str(refused), logging.INFO)


if __name__ == "__main__":
    main(run)
