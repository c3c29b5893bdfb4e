"""How a node takes part in a run: it joins, answers, comes back after a loss, and leaves when it is told to."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from meanflock.agent.node import Agent
from meanflock.net import keys, tick
from meanflock.net.bus import Bus, Delivery, MemoryNetwork
from meanflock.net.client import NodeClient, take_part
from meanflock.swarm.errors import BadInput, BusError, Refused, RunFailed, WorldGone
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, Event, Join, Message, Refusal, Sense, Stop, Welcome
from tests.polling import DEADLINE_S

RUN = "client"
TAKEN = Refusal("UAV 3 has its agent already", for_now=True)
NEVER = Refusal("UAV 9: this run has UAVs 0 to 3")
WELCOME = Welcome(keys.fingerprint(RUN), "agent-3", (3,), 0, b"{}", np.zeros((4, 4), np.float32))
MINE = Join("agent", 1, 3)


class Node:
    """A node that takes until it may go on for odd ticks, and must never be asked twice at once."""

    def __init__(self) -> None:
        self.answered: list[tuple[int, int]] = []  # tick and thread of every answer
        self.problems: list[str] = []
        self.begun, self.go_on = threading.Event(), threading.Event()
        self._work = threading.Lock()

    def act(self, sense: Sense) -> Act:
        assert self._work.acquire(blocking=False)
        if sense.tick % 2:
            self.begun.set()
            assert self.go_on.wait(DEADLINE_S)
        self.answered.append((sense.tick, threading.get_ident()))
        self._work.release()
        return Act(keys.fingerprint(RUN), sense.tick, np.zeros((1, 5)))


class World:
    """A world in memory that answers joins in turn, the last answer for ever; None is no answer."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *answers: Message | None) -> None:
        network = MemoryNetwork()
        self.bus, self.joins, self._answers = network.endpoint(), list[bytes](), answers
        self.bus.subscribe(keys.act(RUN, "*"))
        bus = network.endpoint()
        monkeypatch.setattr(bus, "ask", self._ask)
        self.client = NodeClient(bus, RUN)

    def _ask(self, _key: str, raw: bytes, _timeout_s: float) -> bytes | None:
        self.joins.append(raw)
        answer = self._answers[min(len(self.joins), len(self._answers)) - 1]
        return None if answer is None else control.encode(answer)

    def join(self, node: Any, timeout_s: float = DEADLINE_S, **options: Any) -> Welcome:
        return self.client.join(MINE, lambda _: node, timeout_s, **options)

    def ask(self, number: int) -> None:
        sense = Sense(keys.fingerprint(RUN), number, np.zeros((1, 4)))
        self.bus.put(keys.sense(RUN, WELCOME.node), tick.write_sense(sense))

    def hear(self) -> Delivery:
        return self.bus.receive(DEADLINE_S)


def test_a_join_is_repeated_with_the_same_token_until_it_is_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    tokens = set()
    for answers in ((None, None, WELCOME), (TAKEN, TAKEN, WELCOME)):
        world = World(monkeypatch, *answers)
        assert world.join(Node()).uavs == (3,)
        assert len(world.joins) == 3
        assert len(set(world.joins)) == 1
        tokens.add(control.decode(world.joins[0]).token)
    assert len(tokens - {0}) == 2  # every node has its own


@pytest.mark.parametrize(
    ("answer", "timeout_s", "stops_after", "expected", "joins"),
    [
        (TAKEN, 0.6, 99, "refused: UAV 3 has its agent already", None),
        (TAKEN, DEADLINE_S, 2, "interrupted .*UAV 3", 2),
        (NEVER, DEADLINE_S, 99, "refused: UAV 9", 1),
        (None, 0.0, 99, "no world of run 'client'", None),
    ],
    ids=["for now", "interrupted", "for good", "no answer"],
)
def test_a_node_that_is_not_accepted_says_why(answer, timeout_s, stops_after, expected, joins, monkeypatch) -> None:
    world = World(monkeypatch, answer)
    with pytest.raises(BusError, match=expected):
        world.join(Node(), timeout_s, cancelled=lambda: len(world.joins) >= stops_after)
    assert joins in (None, len(world.joins))


def test_a_tick_is_answered_in_the_thread_that_asks_and_never_beside_another(monkeypatch: pytest.MonkeyPatch) -> None:
    world, node = World(monkeypatch, WELCOME), Node()
    world.join(node)
    world.hear()  # Ready
    over, here = threading.Event(), threading.get_ident()
    loop = threading.Thread(target=world.client.serve, args=(over.is_set, lambda: False))
    other = threading.Thread(target=world.ask, args=(1,))
    loop.start()
    try:
        world.ask(0)
        other.start()
        assert node.begun.wait(DEADLINE_S)
        world.ask(2)  # the node is at work: this one waits
        assert node.answered == [(0, here)]
        node.go_on.set()
        answers = [world.hear() for _ in range(3)]
        assert [tick.read_act(answer.payload).tick for answer in answers] == [0, 1, 2]
        world.ask(2)  # again: the same answer, and the node learns nothing twice
        assert world.hear() == answers[-1]
    finally:
        over.set()
        node.go_on.set()
        other.join()
        loop.join()
    assert node.answered == [(0, here), (1, other.ident), (2, loop.ident)]


# -- a part from its beginning to its end -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "raised", "text"),
    [
        (RunFailed("coding 'good': no such number"), BadInput, "coding 'good': no such number"),  # no other replaces it
        (GeneratorExit("of a plug-in"), GeneratorExit, "GeneratorExit: of a plug-in (test_client.py, line "),
    ],
    ids=["a coding", "no Exception"],
)
def test_a_node_that_fails_for_good_tells_the_world_why(error, raised, text, monkeypatch) -> None:
    world, node = World(monkeypatch, WELCOME), Node()
    world.join(node)
    answers = [failing(error), node.act]  # a second call would succeed
    monkeypatch.setattr(node, "act", lambda sense: answers.pop(0)(sense))
    world.ask(0)
    with pytest.raises(raised, match=str(error)):
        world.client.serve(lambda: False, lambda: False)
    heard = [control.decode(world.hear().payload) for _ in ("ready", "event")]
    assert isinstance(heard[-1], Event)
    assert heard[-1].kind == "failed"
    assert heard[-1].text.startswith(text)


def failing(error: BaseException) -> Callable[[Sense], Act]:
    def act(_sense: Sense) -> Act:
        raise error

    return act


def nowhere(_timeout_s: float) -> Bus:
    raise BusError("cannot open a session")


def alone(_timeout_s: float) -> Bus:
    return MemoryNetwork().endpoint()


def take(connect: Callable[[float], Bus], wait_s: float = 60.0, is_over: bool = False) -> str:
    return take_part(connect, RUN, MINE, Agent, wait_s, lambda: is_over, lambda: False)


def test_a_node_without_a_world_leaves_when_it_is_told_to_or_says_so_in_time() -> None:
    for connect in (nowhere, alone):
        assert take(connect, is_over=True) == "interrupted"
    with pytest.raises(BusError, match="cannot open a session"):
        take(nowhere, wait_s=0.0)


LOST = WorldGone("gone")
REFUSED = Refused("the world refused: no", over=True)


@pytest.mark.parametrize(
    ("script", "ends"),
    [
        ([REFUSED], REFUSED),  # it never flew
        ([LOST, REFUSED], "the world refused: no"),  # the flight is over
        ([LOST, LOST, REFUSED], "the world refused: no"),
        ([Stop(1, "for a reason", lost=True), Stop(1, "lost: and found")], "lost: and found"),  # it joins again
    ],
)
def test_a_node_joins_again_until_it_is_stopped_or_the_flight_is_over(script, ends, monkeypatch) -> None:
    script = list(script)

    def join(*_: object) -> None:
        if script[0] is REFUSED:
            raise script.pop(0)

    def serve(node: NodeClient, *_: object) -> str:
        if (step := script.pop(0)) is LOST:
            raise step
        node.stopped = step
        return str(step.reason)

    monkeypatch.setattr(NodeClient, "join", join)
    monkeypatch.setattr(NodeClient, "serve", serve)
    try:
        ended: Any = take(alone)
    except Refused as error:
        ended = error
    assert (ended, script) == (ends, [])
