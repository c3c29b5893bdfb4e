"""The suite for filters lets ours through, and says of every kind of wrong one what to mend."""

import time
from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.filtered import Filter
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Filter as FilterTable
from meanflock.swarm.scenario import Scenario
from meanflock.testing import ConformanceError, check_filter


@pytest.mark.parametrize("broadcast", ["event", "tick"])
@pytest.mark.parametrize("name", plugins.names("filter"))
def test_every_filter_of_ours_conforms(name: str, broadcast: Any) -> None:
    check_filter(plugins.load("filter", name), scenario=Scenario(uavs=6, filter=FilterTable(broadcast=broadcast)))


class Good(Filter):
    """Pulls away from the mean of all others as it knows them, from which the wrong ones are made."""

    name = "good"
    columns = ("apart",)

    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        away = own[:, :2] - others[:, :, :2].mean(axis=1)
        return wanted + 0.1 * away, np.hypot(away[:, :1], away[:, 1:])


def test_a_good_one_conforms() -> None:
    check_filter(Good)


class SeesAnotherRow(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        after, said = super().admit(own, others, uavs, wanted)
        return after + own[:, :2].sum(axis=0), said


class DrawsItsOwn(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        after, said = super().admit(own, others, uavs, wanted)
        return after + np.random.normal(size=after.shape), said  # noqa: NPY002  # that is what is wrong with it


class RemembersElsewhere(Good):
    ticks = 0

    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        self.ticks += 1
        after, said = super().admit(own, others, uavs, wanted)
        return after * self.ticks, said


class WritesToTheCommands(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        wanted += 1.0
        return super().admit(own, others, uavs, wanted)


class ReportsNothing(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        return wanted, np.zeros((len(own), 0))


class ReturnsTheCommands(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        return wanted


class NotANumber(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        return wanted * np.nan, np.zeros((len(own), 1))


class MakesUpNumbers(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        return np.nan_to_num(wanted), np.zeros((len(own), 1))


class Raises(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        raise OSError("no such table")


class Leaves(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        raise SystemExit(3)


class AText(Good):
    columns = "apart"  # type: ignore[assignment]


class Open(Filter):
    name = "open"


@pytest.mark.parametrize(
    ("wrong", "says", "mend"),
    [
        (SeesAnotherRow, "beside others in one process than alone", "compute every row"),
        (DrawsItsOwn, "otherwise a second time", "draw from mf.seeds"),
        (RemembersElsewhere, "from a checkpoint differs", "in the arrays of the memory"),
        (WritesToTheCommands, "`admit` writes to an array", "copy before you write"),
        (ReportsNothing, r"returns shapes \(\(6, 2\), \(6, 0\)\), expected \(\(6, 2\), \(6, 1\)\)", "`columns` wide"),
        (ReturnsTheCommands, "`admit` returns a ndarray", "return the accelerations and"),
        (NotANumber, "not finite", "guard divisions"),
        (MakesUpNumbers, "makes a number of a command that is none", "let it pass"),
        (Raises, r"`admit` failed: OSError: no such table \(test_filters.py, line \d+\)", "any states must do"),
        (Leaves, "`admit` failed: SystemExit: 3", "any states must do"),
        (AText, r"cannot be made: TypeError: `columns` is a text; write \('apart',\)", ""),
        (Open, "lacks `admit`", ""),
    ],
)
def test_a_wrong_one_is_told_what_to_mend(wrong: type[Filter], says: str, mend: str) -> None:
    with pytest.raises(ConformanceError, match=rf"^{wrong.__name__}: .*{says}.*; .*{mend}"):
        check_filter(wrong)


class Slow(Good):
    def admit(self, own, others, uavs, wanted):  # type: ignore[no-untyped-def]
        time.sleep(0.004)
        return super().admit(own, others, uavs, wanted)


def test_a_slow_one_is_told_how_slow() -> None:
    with pytest.raises(ConformanceError, match=r"^Slow: a tick of 6 UAVs takes \d+ ms; make it quicker"):
        check_filter(Slow, slow_ms=3.0)
