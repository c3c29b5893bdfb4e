"""The barrier of a tick: who was asked, what was asked, and who has answered."""

import threading
from collections import Counter

from swarm import keys, plain
from swarm.bus import Bus
from swarm.errors import MessageRejected
from swarm.messages import Act, Frames, Sense
from swarm.scenario import Scenario
from swarm.state import States
from worldsim.answers import Answers
from worldsim.members import Member
from worldsim.questions import Questions


class Crowd:
    """Nodes that are asked together, and the keys of their questions and answers."""

    def __init__(self, members: list[Member], run: str) -> None:
        self.members = members
        self.questions = [keys.sense(run, member.name) for member in members]
        self.by_name = {member.name: member for member in members}
        self.by_answer = {keys.act(run, member.name): member for member in members}
        places = [member.place for member in members]
        self.firsts = [place.start for place in places if isinstance(place, slice)]
        sizes = {member.rows for member in members}
        self.rows = sizes.pop() if len(sizes) == 1 and len(self.firsts) == len(members) else 0  # where they are alike


class Barrier:
    """The questions of one tick after the other.

    Sound answers are taken in whatever thread brings them, all else in that of the world.
    """

    def __init__(self, bus: Bus, run: str, scenario: Scenario) -> None:
        self._bus, self._run, self._fingerprint = bus, run, keys.fingerprint(run)
        self._answers = Answers(scenario, self._fingerprint)
        self._questions: dict[str, bytes] = {}  # to whom was asked alone, by name
        self._cut: Questions | None = None  # all others
        self._silent: dict[str, Member] = {}  # who has yet to answer, by the key of the answer
        self._gate = threading.RLock()  # of that and of the answers
        self._crowd = Crowd([], run)  # who was last asked plainly
        self._repeats: Counter[str] = Counter()  # second answers that may still come, by the node's name
        self._tick, self.reporting = -1, False
        self.asked: dict[str, Member] = {}
        self.outcomes: dict[str, bytes] = {}  # of whoever has answered, (M, 5) f8
        self.reports: dict[str, bytes] = {}  # of them, the models, (M, 246) f8,
        self.outboxes: dict[str, tuple[Frames, ...]] = {}  # and frames, where there are any;
        self.acts: dict[str, Act] = {}  # the whole answers of those that were not told by their bytes
        self.standing = False  # between the first question of a tick and the last answer

    def open(self, tick: int, reporting: bool) -> None:
        """A new tick, in which agents report their models or not: nobody is asked yet."""
        with self._gate:
            self._tick, self.reporting = tick, reporting
            self.asked, self.outcomes, self.reports, self.outboxes, self.acts = {}, {}, {}, {}, {}
            self._questions, self._silent = {}, {}
            self._answers.open(tick, reporting)
            self.standing = True

    def close(self) -> None:
        """The tick waits for nobody any more; what comes now is late."""
        with self._gate:
            self.standing = False
            self._silent = {}

    def ask(self, member: Member, states: States, heard: tuple[Frames, ...] = (), whole: bool = False) -> None:
        """Asks a node, which has these states and received these frames, and expects its answer.

        `whole`: it is to answer with all that a checkpoint keeps.
        """
        report = self.reporting and len(states) > 0
        self._put(member, plain.encode(Sense(self._fingerprint, self._tick, states, report, heard, whole)))

    def ask_all(self, members: list[Member], states: States, brought: Frames | None = None) -> None:
        """Asks nodes that hold UAVs and have received nothing but, perhaps, a global model (`questions.Questions`);
        `states` (N, 4) are everyone's.
        """
        cut = self._cut = Questions(self._fingerprint, self._tick, self.reporting, states, brought)
        if members != self._crowd.members:  # as a rule they are those of the last tick
            self._crowd = Crowd(members, self._run)
        with self._gate:
            self.asked.update(self._crowd.by_name)
            self._silent.update(self._crowd.by_answer)
        crowd, put = self._crowd, self._bus.put
        alike = cut.of_each(crowd.rows, crowd.firsts) if crowd.rows else None
        questions = map(cut.of, members) if alike is None else alike
        for key, question in zip(crowd.questions, questions, strict=True):
            put(key, question)

    def _put(self, member: Member, question: bytes) -> None:
        name = member.name
        with self._gate:
            self.asked[name] = self._silent[keys.act(self._run, name)] = member
            self._questions[name] = question
        self._bus.put(keys.sense(self._run, name), question)

    def ask_again(self) -> None:
        """Repeats every question nobody answered yet."""
        for name in self.missing:
            self._repeats[name] += 1
            if (question := self._questions.get(name)) is None:
                assert self._cut is not None
                question = self._cut.of(self.asked[name])
            self._bus.put(keys.sense(self._run, name), question)

    def overhear(self, key: str, raw: bytes, but: int = 1) -> bool:
        """Takes a sound answer (`worldsim.answers`) that is waited for, whoever brings it; with whatever else this is,
        nothing is done. Nor with the last `but` one: it goes to who waits for it, who would not wake otherwise.
        """
        with self._gate:
            member = self._silent.get(key)
            if member is None or len(self._silent) <= but:
                return False
            if (answer := self._answers.read(member, raw)) is None:
                return False
            self.outcomes[member.name], report, outbox = answer
            if report:
                self.reports[member.name] = report
            if outbox:
                self.outboxes[member.name] = outbox
            del self._silent[key]
            return True

    def answer(self, name: str, act: Act) -> None:
        """Takes any answer.

        Raises:
            MessageRejected: `duplicate`: the node was not asked, or has answered.
        """
        with self._gate:
            if self._silent.pop(keys.act(self._run, name), None) is None:
                raise MessageRejected("duplicate", f"second answer of {name} to tick {act.tick}")
            self.outcomes[name], self.acts[name] = act.outcome.tobytes(), act
            if act.outbox:
                self.outboxes[name] = act.outbox

    def is_repeat(self, name: str) -> bool:
        """Whether an answer of a node that is not waited for is that to a question it was asked again, for which it
        cannot be blamed; true once for every such question.
        """
        if is_due := self._repeats[name] > 0:
            self._repeats[name] -= 1
        return is_due

    def forget(self, name: str) -> bool:
        """A node is gone: what it said in this tick counts no more. Returns whether it had been asked."""
        with self._gate:
            self._silent.pop(keys.act(self._run, name), None)
            self._repeats.pop(name, None)
            for said in (self.outcomes, self.reports, self.outboxes, self.acts):
                said.pop(name, None)
            return self.asked.pop(name, None) is not None

    @property
    def spoken(self) -> list[Frames]:
        """What everyone has said by radio, in the order in which they were asked."""
        if not self.outboxes:
            return []
        return [batch for name in self.asked for batch in self.outboxes.get(name, ())]

    @property
    def missing(self) -> list[str]:
        """Who has not answered."""
        with self._gate:
            return [member.name for member in self._silent.values()]

    @property
    def silent(self) -> int:
        """How many that is."""
        return len(self._silent)

    @property
    def complete(self) -> bool:
        """Whether everyone has."""
        return not self._silent
