"""The barrier of a tick: who was asked, what was asked, and who has answered."""

from collections import Counter
from collections.abc import Iterable

from swarm import keys, plain
from swarm.bus import Bus
from swarm.errors import MessageRejected
from swarm.messages import Act, Frames, Sense
from swarm.state import States
from worldsim.members import Member


class Barrier:
    """The questions of one tick after the other."""

    def __init__(self, bus: Bus, run: str) -> None:
        self._bus, self._run, self._fingerprint = bus, run, keys.fingerprint(run)
        self._questions: dict[str, bytes] = {}
        self._silent: dict[str, Member] = {}  # who has yet to answer, by the key of the answer
        self._repeats: Counter[str] = Counter()  # second answers that may still come, by the node's name
        self._tick, self.reporting = -1, False
        self.asked: dict[str, Member] = {}
        self.outcomes: dict[str, bytes] = {}  # of whoever has answered, (M, 5) f8
        self.acts: dict[str, Act] = {}  # of them, the answers that say more than that
        self.standing = False  # between the first question of a tick and the last answer

    def open(self, tick: int, reporting: bool) -> None:
        """A new tick, in which agents report their models or not: nobody is asked yet."""
        self._tick, self.reporting = tick, reporting
        self.asked, self.outcomes, self.acts, self._questions, self._silent = {}, {}, {}, {}, {}
        self.standing = True

    def close(self) -> None:
        """The tick waits for nobody any more; what comes now is late."""
        self.standing = False
        self._silent = {}

    def ask(self, member: Member, states: States, heard: tuple[Frames, ...] = (), whole: bool = False) -> None:
        """Asks a node, which has these states and received these frames, and expects its answer.

        `whole`: it is to answer with all that a checkpoint keeps.
        """
        report = self.reporting and len(states) > 0
        self._put(member, plain.encode(Sense(self._fingerprint, self._tick, states, report, heard, whole)))

    def ask_plainly(self, members: Iterable[Member], states: States) -> None:
        """Asks nodes that hold UAVs, have received nothing and are to answer as ever; `states` (N, 4) are everyone's.

        Most questions are such ones. They are cut from one string: where every UAV has a node of its own, that takes
        a third of the time of as many arrays.
        """
        everyone, size = states.tobytes(), states.itemsize * states.shape[1]
        for member in members:
            before, after = plain.senses(self._fingerprint, len(member.uavs), self.reporting).frame(self._tick)
            place = member.place
            if isinstance(place, slice):
                self._put(member, before + everyone[place.start * size : place.stop * size] + after)
            else:
                self._put(member, before + states[place].tobytes() + after)

    def _put(self, member: Member, question: bytes) -> None:
        name = member.name
        self.asked[name] = self._silent[keys.act(self._run, name)] = member
        self._questions[name] = question
        self._bus.put(keys.sense(self._run, name), question)

    def ask_again(self) -> None:
        """Repeats every question nobody answered yet."""
        for name in self.missing:
            self._repeats[name] += 1
            self._bus.put(keys.sense(self._run, name), self._questions[name])

    def hear(self, key: str, raw: bytes) -> bool:
        """Takes a plain answer (`swarm.plain`) that is waited for; with whatever else this is, nothing is done.

        Most messages are such answers, so they are told first, and by few steps.
        """
        member = self._silent.get(key)
        if member is None or not (rows := len(member.uavs)):
            return False
        answers = plain.acts(self._fingerprint, rows, self.reporting)
        if self.reporting:
            if (arrays := answers.decode(self._tick, raw)) is None:
                return False
            self.answer(member.name, Act(self._fingerprint, self._tick, arrays[0], report=arrays[1]))
            return True
        if (outcome := answers.body(self._tick, raw)) is None:
            return False
        self.outcomes[member.name] = outcome
        del self._silent[key]
        return True

    def answer(self, name: str, act: Act) -> None:
        """Takes any answer.

        Raises:
            MessageRejected: `duplicate`: the node was not asked, or has answered.
        """
        if self._silent.pop(keys.act(self._run, name), None) is None:
            raise MessageRejected("duplicate", f"second answer of {name} to tick {act.tick}")
        self.outcomes[name], self.acts[name] = act.outcome.tobytes(), act

    def is_repeat(self, name: str) -> bool:
        """Whether an answer of a node that is not waited for is that to a question it was asked again, for which it
        cannot be blamed; true once for every such question.
        """
        if is_due := self._repeats[name] > 0:
            self._repeats[name] -= 1
        return is_due

    def forget(self, name: str) -> bool:
        """A node is gone: what it said in this tick counts no more. Returns whether it had been asked."""
        self._silent.pop(keys.act(self._run, name), None)
        self._repeats.pop(name, None)
        self.outcomes.pop(name, None)
        self.acts.pop(name, None)
        return self.asked.pop(name, None) is not None

    @property
    def missing(self) -> list[str]:
        """Who has not answered."""
        return [member.name for member in self._silent.values()]

    @property
    def complete(self) -> bool:
        """Whether everyone has."""
        return not self._silent
