"""The barrier of a tick: who was asked, what was asked, and who has answered."""

from swarm import plain
from swarm.bus import Bus
from swarm.errors import MessageRejected
from swarm.keys import sense as sense_key
from swarm.messages import Act, Sense
from worldsim.members import Member


class Barrier:
    """The questions of one tick after the other."""

    def __init__(self, bus: Bus, run: str) -> None:
        self._bus, self._run = bus, run
        self._questions: dict[str, bytes] = {}
        self.asked: dict[str, Member] = {}
        self.acts: dict[str, Act] = {}
        self.standing = False  # between the first question of a tick and the last answer

    def open(self) -> None:
        """A new tick: nobody is asked yet."""
        self.asked, self.acts, self._questions = {}, {}, {}
        self.standing = True

    def ask(self, member: Member, sense: Sense) -> None:
        """Asks a node and expects its answer."""
        self.asked[member.name] = member
        raw = self._questions[member.name] = plain.encode(sense)
        self._bus.put(sense_key(self._run, member.name), raw)

    def ask_again(self) -> None:
        """Repeats every question nobody answered yet."""
        for name in self.missing:
            self._bus.put(sense_key(self._run, name), self._questions[name])

    def answer(self, name: str, act: Act) -> None:
        """Takes an answer.

        Raises:
            MessageRejected: `duplicate`: the node was not asked, or has answered.
        """
        if name not in self.asked or name in self.acts:
            raise MessageRejected("duplicate", f"second answer of {name} to tick {act.tick}")
        self.acts[name] = act

    def forget(self, name: str) -> bool:
        """A node is gone: what it said in this tick counts no more. Returns whether it had been asked."""
        self.acts.pop(name, None)
        return self.asked.pop(name, None) is not None

    @property
    def missing(self) -> list[str]:
        """Who has not answered."""
        return [name for name in self.asked if name not in self.acts]

    @property
    def complete(self) -> bool:
        """Whether everyone has."""
        return len(self.acts) >= len(self.asked)
