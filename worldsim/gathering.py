"""Before take-off: the world waits until everyone who is needed has joined."""

from collections.abc import Callable

from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.worldsim.admission import Admission
from meanflock.worldsim.members import Members


class Gathering:
    """Who is there, and who is still waited for."""

    def __init__(self, members: Members, admission: Admission, stations: int) -> None:
        """`stations`: how many recording listeners must be there."""
        self._members, self._admission, self._stations = members, admission, stations

    @property
    def complete(self) -> bool:
        """Whether every UAV has its agent, the rounds their leader, and whoever records is there."""
        return self._members.complete and len(self._admission.listeners) >= self._stations

    @property
    def missing(self) -> str:
        """Who is not there yet."""
        absent = self._stations - len(self._admission.listeners)
        return ", ".join(filter(None, [self._members.missing(), f"{absent} ground station" if absent > 0 else ""]))

    def check(self, late_s: float | None, cancelled: bool, stop: Callable[[str], None]) -> None:
        """Everyone is sent home by `stop` where the swarm will not be complete. `late_s`: the time that is over.

        Raises:
            BadInput: a node cannot take part. RunFailed: not in time, or interrupted; the message says who is missing.
        """
        if self._admission.unfit:
            stop("a node cannot take part")
            raise BadInput(self._admission.unfit[0])
        if cancelled:
            stop("interrupted")
            raise RunFailed(f"interrupted while waiting for {self.missing}")
        if late_s is not None:
            stop("the swarm is not complete")
            raise RunFailed(f"after {late_s:.0f} s the swarm still waits for {self.missing}")
