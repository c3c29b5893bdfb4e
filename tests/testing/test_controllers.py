"""The suite for controllers lets ours and a stranger's through, and says of every kind of wrong one what to mend."""

import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from meanflock.agent.controllers.base import Controller
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Obstacle, Scenario, Start
from meanflock.testing import ConformanceError, check_aggregator, check_controller
from tests.testing.wrong_controllers import (
    CannotBeMade,
    DrawsAsItShould,
    DrawsFromNumPy,
    DrawsItsOwn,
    Elsewhere,
    GetRaises,
    Good,
    Leaves,
    NamedAsAColumn,
    Nameless,
    NoDiagnostics,
    NotANumber,
    NotANumberBroadcast,
    NotANumberMemory,
    NotANumberModel,
    OtherWidths,
    Raises,
    RefusesNobody,
    RemembersElsewhere,
    ReportRaises,
    SeesAnotherRow,
    SetRaises,
    SetReturnsNothing,
    SetReturnsTheRows,
    SetsEverybody,
    Silent,
    Slow,
    TakesNoModel,
    WritesToItsArguments,
    WritesToItsStates,
    WritesToTheNumbers,
    WritesToThePlan,
    WrongAcceleration,
    WrongMemory,
    WrongModel,
)

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("name", plugins.names("controller"))
def test_every_controller_of_ours_conforms(name: str) -> None:
    check_controller(plugins.load("controller", name))


DISCS = (Obstacle(centre=(140.0, 96.0), radius=4.0), Obstacle(centre=(152.0, 90.0), radius=3.0))


@pytest.mark.parametrize("name", ["vasarhelyi", "olfati-saber", "potential-field"])
@pytest.mark.parametrize("uavs", [1, 6])
@pytest.mark.parametrize("options", [{"broadcast": "tick", "forget_s": 0.2}, {"repeats": 3, "delta_m": 0.02}])
def test_a_flock_conforms_alone_and_among_obstacles(name: str, uavs: int, options: dict[str, Any]) -> None:
    scenario = Scenario(uavs=uavs, obstacles=DISCS, start=Start(spacing=0.5))
    check_controller(plugins.load("controller", name), options, scenario)


@pytest.mark.parametrize(("file", "name"), [("spring.py", "Spring"), ("trim.py", "Trim")])
def test_the_examples_conform(file: str, name: str) -> None:
    check_controller(runpy.run_path(str(EXAMPLES / file))[name], {"stiffness": 0.05})


def test_the_example_of_a_rule_conforms() -> None:
    check_aggregator(runpy.run_path(str(EXAMPLES / "momentum.py"))["Momentum"], {"beta": 0.9})


def test_the_first_example_is_short_and_imports_the_python_door_alone() -> None:
    text = (EXAMPLES / "spring.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 25
    assert re.findall(r"^(?:import|from) (\w+)", text, flags=re.M) == ["typing", "numpy", "msgspec", "meanflock"]


def test_a_good_one_conforms() -> None:
    check_controller(Good)


def test_one_that_draws_by_tick_and_uav_conforms() -> None:
    check_controller(DrawsAsItShould)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (NotANumberBroadcast, "broadcast 0 has a number that is not finite; such a frame is not sent"),
        (NotANumberMemory, r"memory\['heard'\] is not finite; guard"),
        (NotANumberModel, "`get` returns a number that is not finite; guard"),
        (OtherWidths, "broadcast 0 is 1 × float64 and 2 × float64, as the UAV is; say as many"),
        (RefusesNobody, "`refused` names UAVs from -1"),
        (Leaves, r"failed in tick 0: SystemExit: 3 \(wrong_controllers.py, line \d+\)"),
        (CannotBeMade, r"cannot be made: OSError: no such device \(wrong_controllers.py, line \d+\)"),
        (GetRaises, "`get` failed: KeyError: 'weights'.*; return one row a UAV, `parameters` wide"),
        (SetRaises, "`set` failed: KeyError: 'weights'.*; return the memory with `models`"),
        (SetReturnsTheRows, r"`set` returns what a flight cannot use: memory\['model'\] is \(2, 3\)"),
        (SetReturnsNothing, "`set` returns what a flight cannot use: memory is a NoneType"),
        (ReportRaises, "`report` failed: KeyError: 'weights'"),
        (WritesToTheNumbers, "`init` writes to an array it was given; return new arrays"),
        (WritesToThePlan, "`init` writes to an array it was given; return new arrays"),
        (Elsewhere, "a name is up to 64 of"),
        (Silent, "lacks `step`"),
        (TakesNoModel, "declares `parameters` must override `set`"),
        (SeesAnotherRow, "beside others in one process than alone.*every row"),
        (DrawsItsOwn, "a second time.*mf.seeds"),
        (DrawsFromNumPy, "a second time.*mf.seeds"),
        (RemembersElsewhere, "checkpoint differs.*memory you return"),
        (WrongAcceleration, r"acceleration has shape \(\d, 3\); expected \(\d, 2\)"),
        (NoDiagnostics, "no diagnostics"),
        (WrongModel, r"`get` returns shape \(6, 3\), expected \(6, 4\)"),
        (NotANumber, "not finite.*guard"),
        (WritesToItsArguments, "writes to an array.*copy"),
        (WritesToItsStates, "writes to an array.*copy"),
        (NamedAsAColumn, "the time series has columns of that name; give it another"),
        (SetsEverybody, "rows it was not told to"),
        (Raises, "failed in tick 0: IndexError"),
        (Nameless, "no `name`"),
        (WrongMemory, "leading axis"),
    ],
)
def test_a_wrong_one_is_told_what_to_mend(wrong: type[Controller], says: str) -> None:
    with pytest.raises(ConformanceError, match=says):
        check_controller(wrong)


def test_a_slow_one_is_told_how_slow() -> None:
    with pytest.raises(ConformanceError, match=r"takes \d+ ms"):
        check_controller(Slow, slow_ms=3.0)


@pytest.mark.parametrize("given", ["good", Good(Good.Options(), Scenario())])
def test_what_is_no_class_is_told_so(given: Any) -> None:
    with pytest.raises(ConformanceError, match="it is no class; pass the class itself"):
        check_controller(given)
