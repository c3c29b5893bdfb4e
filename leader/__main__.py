"""`python -m leader`: the process that averages the models."""

from leader.node import Leader
from swarm import keys, logs
from swarm.identity import LEADER
from swarm.messages import Join
from swarm.process import Interrupted, identity, main, orphaned, parser
from swarm.session import ZenohBus
from swarm.spoke import Spoke


def _run() -> None:
    given = parser("leader", "The federated leader.", "python -m leader --run test").parse_args()
    known = logs.start(given.log_format, run=given.run, node=LEADER)
    interrupted = Interrupted()
    bus = ZenohBus.client(given.endpoint, given.wait, identity(given.tls, LEADER))
    try:
        spoke = Spoke(bus, keys.check_run(given.run))
        welcome = spoke.join(Join("leader", 0), Leader, given.wait, lambda: bool(interrupted) or orphaned())
        known["node"] = welcome.node
        spoke.serve(interrupted.__bool__, orphaned)
    finally:
        bus.close()


if __name__ == "__main__":
    main(_run)
