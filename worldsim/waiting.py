"""How a tick waits: for all answers in lockstep, until its time is over in real time; for an agent if all are lost."""

from collections.abc import Callable

from meanflock.swarm.errors import RunFailed
from meanflock.worldsim.admission import Admission
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.durations import Durations
from meanflock.worldsim.members import LEADER
from meanflock.worldsim.pace import Pace
from meanflock.worldsim.schedule import Schedule

STALL_S = 0.5  # who looks ten times a second and comes late by more stood still, and the nodes may have, too
ASK_AGAIN_S = 1.0  # a Sense nobody answered is repeated: the first after a declaration can get lost


class Waiting:
    """The world's patience with its nodes."""

    def __init__(
        self,
        barrier: Barrier,
        admission: Admission,
        counters: Counters,
        schedule: Schedule | None,
        patience_s: float,
        pace: Pace,
        receive: Callable[[float], None],
        clock: Callable[[], float],
    ) -> None:
        """`schedule`: of a flight in real time. `patience_s`: how long lockstep waits for a node before it is lost.
        `pace`: in how many ticks it waits almost as long. `receive`: takes the next delivery, or none within that many
        seconds.
        """
        self.took = Durations()  # from the last question of a tick to the last answer, or to the end of the tick
        self._barrier, self._admission, self._counters = barrier, admission, counters
        self._schedule, self._patience_s, self._pace = schedule, patience_s, pace
        self._receive, self._clock = receive, clock

    def for_answers(self) -> None:
        """Waits as the flight does."""
        asked = self._clock()
        answered = self._for_everyone() if self._schedule is None else self._until(self._schedule.end)
        self.took.add(answered - asked)

    def for_an_agent(self, cancelled: Callable[[], bool]) -> bool:
        """Before a tick: True at once, unless all agents are lost; then as soon as one is back. Without any there is
        nobody whose flight it would be. False once `cancelled`.

        Raises:
            RunFailed: none came back in time.
        """
        if not self._admission.unattended:
            return True
        end = self._clock() + self._patience_s
        while not any(member.role != LEADER and member.ready for member in self._admission.members.present):
            if cancelled():
                return False
            if self._clock() > end:
                raise RunFailed(f"every agent is lost, and none came back within {self._patience_s:.0f} s")
            self._receive(0.1)
            self._admission.expire(self._patience_s)
        return True

    def _for_everyone(self) -> float:
        """Lockstep: until everyone has answered, or is lost; returns when."""
        now = self._clock()
        waited = asked = before_that = 0.0
        self._pace.begin()
        while self._barrier.silent:
            before = now
            self._receive(0.1)
            now = self._clock()
            waited += min(now - before, STALL_S)
            self._pace.look(waited, self._barrier)
            if waited > self._patience_s:
                for name in self._barrier.missing:
                    self._admission.lose(self._barrier.asked[name], f"no answer for {self._patience_s:.0f} s")
                before_that += waited
                waited = asked = 0.0  # whoever takes over has its own time to answer
            elif waited - asked > ASK_AGAIN_S:
                asked = waited
                self._barrier.ask_again()
        self._pace.charge(before_that + waited, now, self._barrier)
        for verdict in self._pace.overdrawn():
            self._admission.expel(verdict.node, verdict.why, verdict.out_s)
        return now

    def _until(self, end: float) -> float:
        """Real time: until then, whoever has answered; returns when everyone had, if so."""
        answered: float | None = None
        for _ in range(len(self._barrier.asked)):  # what is there already, however late the tick itself began
            self._receive(0.0)
        while (left := end - (now := self._clock())) > 0:
            if answered is None and not self._barrier.silent:
                answered = now
            self._receive(left)
        self._counters.late(sum(len(self._barrier.asked[name].uavs) for name in self._barrier.missing))
        return now if answered is None else answered
