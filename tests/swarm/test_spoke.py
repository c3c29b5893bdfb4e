"""How a node comes to take part: it asks, and asks again as long as asking may help, for one place only."""

import threading
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar

import numpy as np
import pytest

from meanflock.swarm import scenario
from meanflock.swarm.errors import BusError
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus, MemoryNetwork
from meanflock.swarm.net.client import NodeClient
from meanflock.swarm.wire import control, tick
from meanflock.swarm.wire.messages import Act, Event, Join, Message, Refusal, Sense, Welcome
from tests.polling import DEADLINE_S
from tests.swarm.conftest import Open

RUN = "client"
TAKEN = Refusal("UAV 3 has its agent already", for_now=True)
NEVER = Refusal("UAV 9: this run has UAVs 0 to 3")
WELCOME = Welcome(keys.fingerprint(RUN), "agent-3", (3,), 0, b"{}", np.zeros((4, 4), np.float32))


class Door:
    """A world that answers questions one after the other as it was told to, the last answer for ever."""

    def __init__(self, bus: Bus, answers: Sequence[Message]) -> None:
        self.asked = 0
        self._bus, self._answers, self._over = bus, answers, threading.Event()
        bus.answer(keys.join(RUN))
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _serve(self) -> None:
        while not self._over.is_set():
            delivery = self._bus.receive(0.05)
            if delivery is not None and delivery.reply is not None:
                answer = self._answers[min(self.asked, len(self._answers) - 1)]
                self.asked += 1  # before who asks can go on
                delivery.reply(control.encode(answer))


class Deaf:
    """A node nobody asks."""

    complaints: ClassVar[list[str]] = []

    def act(self, sense: Sense) -> Act:
        raise AssertionError(sense)


class Slow:
    """A node that takes until it may go on for odd ticks; never two at once."""

    def __init__(self) -> None:
        self.said: list[tuple[int, int]] = []  # tick and thread of every answer
        self.complaints: list[str] = []
        self.begun, self.go_on = threading.Event(), threading.Event()
        self._work = threading.Lock()

    def act(self, sense: Sense) -> Act:
        assert self._work.acquire(blocking=False)
        if sense.tick % 2:
            self.begun.set()
            assert self.go_on.wait(DEADLINE_S)
        self.said.append((sense.tick, threading.get_ident()))
        self._work.release()
        return Act(keys.fingerprint(RUN), sense.tick, np.zeros((1, 5)))


def asked(number: int) -> bytes:
    return tick.write_sense(Sense(keys.fingerprint(RUN), number, np.zeros((1, 4))))


@pytest.fixture
def opens(network: Open) -> Iterator[Callable[..., tuple[Door, NodeClient]]]:
    """A world that gives these answers, and somebody to ask it."""
    doors: list[Door] = []

    def open_one(*answers: Message) -> tuple[Door, NodeClient]:
        doors.append(Door(network(), answers))
        return doors[-1], NodeClient(network(), RUN)

    yield open_one
    for door in doors:
        door.close()


def join(client: NodeClient, timeout_s: float, cancelled: Callable[[], bool] = lambda: False) -> Welcome:
    return client.join(Join("agent", 1, 3), lambda welcome: Deaf(), timeout_s, cancelled)


def count_asks(client: NodeClient, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The keys it asks under, one an attempt; what a door on a loaded machine hears may be late."""
    asks: list[str] = []
    ask = client._bus.ask

    def counted(key: str, payload: bytes, timeout_s: float) -> bytes | None:
        asks.append(key)
        return ask(key, payload, timeout_s)

    monkeypatch.setattr(client._bus, "ask", counted)
    return asks


def test_who_is_refused_for_now_asks_again_until_it_is_let_in(opens: Callable[..., tuple[Door, NodeClient]]) -> None:
    door, client = opens(TAKEN, TAKEN, WELCOME)
    assert join(client, DEADLINE_S).uavs == (3,)
    assert door.asked >= 3


def test_who_is_refused_for_now_gives_up_when_its_time_is_up_and_says_why(
    opens: Callable[..., tuple[Door, NodeClient]],
) -> None:
    door, client = opens(TAKEN)
    with pytest.raises(BusError, match="refused: UAV 3 has its agent already"):
        join(client, 0.6)
    assert door.asked >= 2


def test_who_is_refused_for_good_does_not_ask_again(
    opens: Callable[..., tuple[Door, NodeClient]], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, client = opens(NEVER)
    asks = count_asks(client, monkeypatch)
    with pytest.raises(BusError, match="refused: UAV 9"):
        join(client, DEADLINE_S)
    assert len(asks) == 1


def test_who_is_interrupted_while_it_is_refused_asks_no_more(
    opens: Callable[..., tuple[Door, NodeClient]], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, client = opens(TAKEN)
    asks = count_asks(client, monkeypatch)
    with pytest.raises(BusError, match=r"interrupted .*UAV 3"):
        join(client, DEADLINE_S, cancelled=lambda: len(asks) >= 2)
    assert len(asks) == 2


def test_a_join_whose_answer_is_lost_is_repeated_with_the_same_token(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = MemoryNetwork()
    flown = scenario.load(None, uavs=1)
    welcome = Welcome(
        keys.fingerprint(RUN), "agent-0", (0,), 0, scenario.encode(flown), np.zeros((1, 4), dtype=np.float32)
    )
    asked: list[bytes] = []

    def ask(_key: str, raw: bytes, _timeout_s: float) -> bytes | None:
        asked.append(raw)
        return control.encode(welcome) if len(asked) == 3 else None

    tokens = set()
    for _ in range(2):
        asked.clear()
        bus = wire.endpoint()
        monkeypatch.setattr(bus, "ask", ask)
        assert NodeClient(bus, RUN).join(Join("agent", 1), lambda welcome: Deaf(), timeout_s=60.0).node == "agent-0"
        assert len(asked) == 3
        assert len(set(asked)) == 1
        join = control.decode(asked[0])
        assert isinstance(join, Join)
        tokens.add(join.token)
    assert len(tokens - {0}) == 2  # every node its own


def test_a_world_that_never_answers_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = MemoryNetwork().endpoint()
    monkeypatch.setattr(bus, "ask", lambda *_: None)
    with pytest.raises(BusError, match="no world of run 'client'"):
        NodeClient(bus, RUN).join(Join("agent", 1), lambda welcome: Deaf(), timeout_s=0.0)


def test_a_tick_is_answered_in_the_thread_that_asks_and_never_beside_another(monkeypatch: pytest.MonkeyPatch) -> None:
    wire, node = MemoryNetwork(), Slow()
    world, bus = wire.endpoint(), wire.endpoint()
    world.subscribe(keys.act(RUN, "*"))
    monkeypatch.setattr(bus, "ask", lambda *_: control.encode(WELCOME))
    client = NodeClient(bus, RUN)
    client.join(Join("agent", 1, 3), lambda welcome: node, DEADLINE_S)
    assert world.receive(0.0) is not None  # it is ready
    over, here = threading.Event(), threading.get_ident()
    loop = threading.Thread(target=client.serve, args=(over.is_set, lambda: False))
    other = threading.Thread(target=world.put, args=(keys.sense(RUN, WELCOME.node), asked(1)))
    loop.start()
    try:
        world.put(keys.sense(RUN, WELCOME.node), asked(0))
        other.start()
        assert node.begun.wait(DEADLINE_S)
        world.put(keys.sense(RUN, WELCOME.node), asked(2))  # it is at work: this one waits
        assert node.said == [(0, here)]
        node.go_on.set()
        answers = [world.receive(DEADLINE_S) for _ in range(3)]
        assert [tick.read_act(answer.payload).tick for answer in answers if answer is not None] == [0, 1, 2]
        world.put(keys.sense(RUN, WELCOME.node), asked(2))  # again: the same answer, and nothing is learned twice
        again = world.receive(DEADLINE_S)
        assert again == answers[-1]
    finally:
        over.set()
        node.go_on.set()
        other.join()
        loop.join()
    assert node.said == [(0, here), (1, other.ident), (2, loop.ident)]


def test_what_a_node_complains_of_reaches_the_world_once_and_before_its_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wire, node = MemoryNetwork(), Slow()
    world, bus = wire.endpoint(), wire.endpoint()
    world.subscribe(keys.act(RUN, "*"))
    monkeypatch.setattr(bus, "ask", lambda *_: control.encode(WELCOME))
    client = NodeClient(bus, RUN)
    client.join(Join("agent", 1, 3), lambda welcome: node, DEADLINE_S)
    node.complaints.append("the controller of UAV 3 has failed")
    for number in (0, 2):
        world.put(keys.sense(RUN, WELCOME.node), asked(number))
    _, said, first, second = (world.receive(DEADLINE_S) for _ in range(4))
    assert said is not None
    assert first is not None
    assert second is not None
    event = control.decode(said.payload)
    assert isinstance(event, Event)
    assert (event.tick, event.text) == (0, "the controller of UAV 3 has failed")
    assert [tick.read_act(answer.payload).tick for answer in (first, second)] == [0, 2]
