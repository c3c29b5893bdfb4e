"""Crews: who answers for the UAVs of a world. A flight is a world, a crew and sinks."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Received
from meanflock.agent.node import Agent
from meanflock.federation.mailbox import links_of, mail_for, picked
from meanflock.federation.plan import Plan
from meanflock.leader.node import Leader
from meanflock.swarm import mission
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.events import FlightEvent, FlightResumed, LeaderTookOver, NodeLost, NodesJoined
from meanflock.swarm.global_generators import DrawWatch
from meanflock.swarm.state import NO_UAV, Floats, Mask, contains
from meanflock.swarm.wire.control import FLOAT_OF_BITS, decode_record, encode_record
from meanflock.swarm.wire.messages import Act, Frames, Sense, Welcome
from meanflock.swarm.workers import each, free_cores
from meanflock.worldsim.checkpoint import Memories, Resumption
from meanflock.worldsim.clocks import TickSchedule
from meanflock.worldsim.tick import Acts, Row, Senses
from meanflock.worldsim.world import KILLED, World

Place: TypeAlias = slice | NDArray[np.intp]  # index of the UAVs of a node among all UAVs


class Crew(Protocol):
    """Answers for all UAVs of a world."""

    def answer(self, senses: Senses) -> tuple[Acts, Mask]:
        """What the UAVs say in a tick, and the mask (N,) of those that do not answer.

        Raises:
            RunFailed: nobody can answer any more.
        """


class Sink(Protocol):
    """Output that takes the rows of a flight."""

    def write(self, row: Row) -> None:
        """Take the next row. Its arrays hold until the next tick."""


def fly(world: World, crew: Crew, sinks: Sequence[Sink] = ()) -> Iterator[Row]:
    """Fly a world to its end, a row a tick; the caller can stop after any.

    Raises:
        RunFailed: the crew or the vehicle failed.
    """
    while not world.over:
        begun = time.perf_counter()
        senses = world.ask()
        world.counters.world_s += time.perf_counter() - begun
        yield move(world, crew.answer(senses), sinks)


def move(world: World, answer: tuple[Acts, Mask], sinks: Sequence[Sink]) -> Row:
    """Fly the tick that was asked for, by the answer of a crew."""
    begun = time.perf_counter()
    row = world.move(*answer)
    world.counters.world_s += time.perf_counter() - begun
    for sink in sinks:
        sink.write(row)
    return row


def inbox_of(senses: Senses, uavs: NDArray[np.intp], after: int) -> tuple[Frames, ...]:
    """What an agent with some UAVs, ascending, is told by radio: the frames that they heard, and their mail.

    `after`: number of the last letter that the agent has read.
    """
    own, has_all = [], len(uavs) == len(senses.states)
    for batch in senses.heard:
        targets = links_of(batch)[:, 1]
        reached = None if has_all else targets == uavs[0] if len(uavs) == 1 else contains(uavs, targets)
        if (part := picked(batch, reached)) is not None:
            own.append(part)
    if senses.newest > after:
        own += mail_for(senses.letters, "agent", uavs, after)
    return tuple(own)


def goals_of(senses: Senses, uavs: NDArray[np.intp]) -> bytes:
    """The goals that an agent with some UAVs, ascending, is told, as a record; empty if none of them changes."""
    if not len(senses.guided):
        return b""
    own = contains(uavs, senses.guided)
    return encode_record({"uavs": senses.guided[own], "goals": senses.goals[own]}) if own.any() else b""


class ReportedModels:
    """The learned weights of all UAVs, (N, W), joined from those of their nodes.

    The array is made once, because of many UAVs that takes a whole tick. It holds until the next report.
    """

    def __init__(self, plan: Plan) -> None:
        self._shape = plan.scenario.uavs, plan.declared.weights
        self._models: Floats | None = None

    def joined(self, reports: Iterable[tuple[Place, Floats | None]]) -> Floats | None:
        """The models with those of each node at the places of its UAVs, NaN for all others; None if nobody learns."""
        if not self._shape[1]:
            return None
        if self._models is None:
            self._models = np.full(self._shape, np.nan)
        silent = np.ones(self._shape[0], dtype=bool)
        for place, models in reports:
            if models is not None:
                self._models[place], silent[place] = models, False
        self._models[silent] = np.nan
        return self._models


def place_of(uavs: NDArray[np.intp]) -> Place:
    """Index of some UAVs, ascending, among all UAVs: a slice if possible, which costs a fraction of an array."""
    if not len(uavs):
        return slice(0)
    first, end = int(uavs[0]), int(uavs[-1]) + 1
    return slice(first, end) if end - first == len(uavs) else uavs


MANY_UAVS = 4096  # from which on a crew uses the cores of its process


class LocalCrew:
    """Agents and a leader in this process. A node of many UAVs is cut into agents that compute side by side in threads.

    Attributes:
        agents: they hold all UAVs, in the order of their first ones.
        received: the frames that the agents with a UAV awake heard in this tick.
    """

    def __init__(
        self,
        world: World,
        resume: Resumption | None = None,
        *,
        rows_at_most: int | None = None,
        threads: int | None = None,
        leaders: int | None = None,
        memory: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        """
        Args:
            world: whose UAVs fly; it is not changed.
            resume: the checkpoint that the world continues from; None: none.
            rows_at_most: most UAVs of a node; None: one node has all.
            threads: agents that compute at once, which have equal parts of a node's UAVs, at least one each; None: one,
                and of many UAVs one for each core. Bits do not depend on it.
            leaders: one and its standbys; None: as many as the fault script needs.
            memory: arrays of N rows that replace the memory of `init`.

        Raises:
            BadInput: a controller cannot be made, its `init` fails, or a memory does not fit.
        """
        plan, scenario, tick = world.plan, world.scenario, world.tick
        uavs = scenario.uavs
        size = uavs if rows_at_most is None else rows_at_most
        self._threads = threads or (free_cores() if uavs >= MANY_UAVS else 1)
        part = max(1, -(-size // self._threads))
        self._plan = plan
        self._encoded = scenarios.encode(plan.node_scenario)
        self._starts = mission.starts(scenario).astype(FLOAT_OF_BITS[scenario.radio.bits_per_float])
        agents: list[tuple[int, str, Agent]] = []  # first UAV, name of the node, agent
        for group in plan.groups:
            for first in range(0, len(group.uavs), size):
                node = group.uavs[first : first + size]
                for begin in range(0, len(node), part):
                    rows = node[begin : begin + part]
                    record = b"" if resume is None else resume.memory(plan.groups, rows)
                    if memory is not None and tick == 0:
                        record = encode_record({name: array[rows] for name, array in memory.items()})
                    name, names = f"agent-{node[0]}", tuple(rows.tolist())
                    agent = Agent(Welcome(0, name, names, tick, self._encoded, self._starts, record))
                    agents.append((names[0], name, agent))
        agents.sort(key=lambda each: each[0])
        self.agents: list[Agent] = [agent for *_, agent in agents]
        self._nodes = [name for _, name, _ in agents]  # of each agent
        self._places = [place_of(agent.uavs) for agent in self.agents]
        self._nothing = np.zeros((uavs, plan.scenario.dimensions + len(plan.declared.diagnostics)))
        self._nobody = np.zeros(uavs, dtype=bool)
        self._reported = ReportedModels(plan)
        self._standbys = plan.leaders(tick) if leaders is None else leaders
        nodes = len(set(self._nodes)) + self._standbys
        self._news: list[FlightEvent] = [(NodesJoined if resume is None else FlightResumed)(tick, nodes, uavs)]
        self._senses: list[tuple[int, Sense]] = []  # of the tick that was heard, by the number of the agent
        self.received: list[tuple[Received, ...]] = []
        self._led = 0  # number of the last leader
        self._leader: Leader | None = None
        self._took_over = True
        self._read = [0] * len(self.agents)  # number of the last letter that each has read
        self._read_by_leader = 0
        self._elect()

    def answer(self, senses: Senses) -> tuple[Acts, Mask]:
        """See `Crew.answer`."""
        self.hear(senses)
        return self.speak(senses)

    def hear(self, senses: Senses) -> None:
        """Let the agents that have a UAV awake hear the frames of a tick."""
        self._senses = []
        self.received = []
        for number, (agent, place) in enumerate(zip(self.agents, self._places, strict=True)):
            if not np.count_nonzero(senses.awake[place]):
                continue
            inbox = inbox_of(senses, agent.uavs, self._read[number])
            self._read[number] = senses.newest
            states = senses.states[place].copy()  # a controller may write to its own
            sense = Sense(0, senses.tick, states, senses.report, senses.checkpoint, inbox, goals_of(senses, agent.uavs))
            self._senses.append((number, sense))
            self.received.append(agent.hear(sense))

    def speak(self, senses: Senses) -> tuple[Acts, Mask]:
        """The answer to the tick that was heard."""
        acts = Acts(self._nothing, has_leader=self._leader is not None, news=self._news)
        self._news = []
        for _ in range(senses.leaders_killed):
            self._lose_leader(senses.tick, acts)
        if senses.leads and self._leader is not None:
            self._lead(self._leader, senses, acts)
        replies = self._replies()
        for number, reply in replies:
            agent = self.agents[number]
            acts.outbox += reply.outbox
            acts.add(reply)
            for problem in agent.problems:
                acts.reports.add(self._nodes[number], agent.uavs, problem)
            agent.problems.clear()
        if len(replies) == len(self.agents) == 1:
            acts.commands, acts.models = replies[0][1].commands, replies[0][1].models
            absent = self._nobody
        else:
            absent = self._join(replies, senses, acts)
        if senses.checkpoint:
            acts.memories = Memories(self._plan.groups)
            for number, reply in replies:
                if reply.memory:
                    acts.memories.take(self.agents[number].uavs, decode_record(reply.memory))
        return acts, absent

    @property
    def models(self) -> Floats:
        """Learned weights of every UAV, (N, W); the last ones of a lost UAV, NaN of those that report none."""
        if len(self.agents) == 1:
            return self.agents[0].models
        each_has = ((place, agent.models) for place, agent in zip(self._places, self.agents, strict=True))
        reports = ((place, models if models.shape[1] else None) for place, models in each_has)
        models = ReportedModels(self._plan).joined(reports)
        return np.zeros((len(self._nobody), 0)) if models is None else models

    def _replies(self) -> list[tuple[int, Act]]:
        """The replies of the agents that have heard, with their numbers."""

        def reply(heard: tuple[tuple[int, Sense], tuple[Received, ...]]) -> tuple[int, Act]:
            (number, sense), received = heard
            return number, self.agents[number].reply(sense, received)

        in_turn = zip(self._senses, self.received, strict=True)
        return each(reply, in_turn) if self._threads > 1 else list(map(reply, in_turn))

    def _join(self, replies: list[tuple[int, Act]], senses: Senses, acts: Acts) -> Mask:
        """Join the commands and models of several agents, by their numbers; returns the UAVs of the others, (N,)."""
        acts.commands, absent = self._nothing.copy(), np.ones(len(self._nobody), dtype=bool)
        for number, reply in replies:
            place = self._places[number]
            acts.commands[place], absent[place] = reply.commands, False
        if senses.report:
            acts.models = self._reported.joined((self._places[number], reply.models) for number, reply in replies)
        return absent

    def _lead(self, leader: Leader, senses: Senses, acts: Acts) -> None:
        """Let the leader answer; one that took over gets the state of the rule, and all mail."""
        record = senses.rule_record if self._took_over else b""
        self._took_over = False
        inbox = mail_for(senses.letters, "leader", after=self._read_by_leader)
        self._read_by_leader = senses.newest
        states = np.zeros((0, self._plan.scenario.state_numbers))
        reply = leader.act(Sense(0, senses.tick, states, inbox=inbox, memory=record))
        acts.outbox += reply.outbox
        acts.add(reply)
        if reply.memory:
            acts.rule_record = reply.memory
        for problem in leader.problems:
            acts.reports.add(_name(self._led), NO_UAV, problem)
        leader.problems.clear()

    def _lose_leader(self, tick: int, acts: Acts) -> None:
        """The fault script kills the leader; the next standby takes over."""
        if self._leader is None:
            return
        lost = _name(self._led)
        acts.news.append(NodeLost(tick, lost, KILLED))
        self._elect()
        acts.has_leader = self._leader is not None
        if acts.has_leader:
            acts.news.append(LeaderTookOver(tick, _name(self._led), lost))

    def _elect(self) -> None:
        self._leader = None
        self._took_over = True
        self._read_by_leader = 0
        if self._standbys:
            self._standbys -= 1
            self._led += 1
            self._leader = Leader(Welcome(0, _name(self._led), (), 0, self._encoded, self._starts))


def _name(leader: int) -> str:
    """Name of the leader of a number."""
    return "leader" if leader == 1 else f"leader.{leader}"


class Watched:
    """Crew that reports, too, that a plug-in of the world's process draws from a global random generator."""

    def __init__(self, crew: Crew, draws: DrawWatch) -> None:
        """`draws`: a watch that began before the plug-ins were made."""
        self._crew, self._draws = crew, draws

    def answer(self, senses: Senses) -> tuple[Acts, Mask]:
        """See `Crew.answer`."""
        acts, absent = self._crew.answer(senses)
        acts.reports.found_draw |= self._draws.finds_a_draw(senses.tick)
        return acts, absent


class Paced:
    """Crew that answers at the end of each tick of a flight in real time."""

    def __init__(
        self,
        crew: Crew,
        schedule: TickSchedule,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """`clock`: seconds, monotonic. `sleep`: waits so many seconds."""
        self._crew = crew
        self._schedule = schedule
        self._clock = clock
        self._sleep = sleep

    def answer(self, senses: Senses) -> tuple[Acts, Mask]:
        """See `Crew.answer`."""
        self._schedule.begin(self._clock())
        answer = self._crew.answer(senses)
        if (left_s := self._schedule.end - self._clock()) > 0:
            self._sleep(left_s)
        return answer
