"""`python -m leader`: the process that averages the models."""

from leader.node import Leader
from swarm import keys, logs
from swarm.attendance import take_part
from swarm.identity import LEADER
from swarm.messages import Join, Welcome
from swarm.process import Interrupted, identity, main, orphaned, parser
from swarm.session import ZenohBus


def _run() -> None:
    given = parser("leader", "The federated leader.", "python -m leader --run test").parse_args()
    known = logs.start(given.log_format, run=given.run, node=LEADER)
    interrupted = Interrupted()
    who, run = identity(given.tls, LEADER), keys.check_run(given.run)

    def connect(timeout_s: float) -> ZenohBus:
        return ZenohBus.client(given.endpoint, timeout_s, who)

    def welcomed(welcome: Welcome) -> None:
        known["node"] = welcome.node

    take_part(connect, run, Join("leader", 0), Leader, given.wait, interrupted.__bool__, orphaned, welcomed)


if __name__ == "__main__":
    main(_run)
