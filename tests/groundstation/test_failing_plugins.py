"""Whatever a plug-in raises in whichever method, the command ends with its exit code and one line of error."""

import pytest

from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED

PLUGINS = """
import meanflock as mf
from tests.testing.good import GoodAggregator, GoodChannel, GoodController, GoodFilter, GoodVehicle


class Odd(BaseException):
    pass


def fail(*_):
    raise RAISED


class Pilot(GoodController):
    name = "pilot"
    period_ticks = 4

    class Options(mf.Options, frozen=True):
        def __post_init__(self):
            if "METHOD" == "Options.__post_init__":
                fail()


class Shield(GoodFilter):
    name = "shield"


class Rule(GoodAggregator):
    name = "rule"


class Air(GoodChannel):
    name = "air"


class Craft(GoodVehicle):
    name = "craft"


owner, _, method = "METHOD".partition(".")
if owner == "import":
    fail()
elif owner not in ("nowhere", "Options"):
    setattr(globals()[owner], method, property(fail) if method == "weights" else fail)
"""
OF_A_CONTROLLER = ("__init__", "weights", "init", "prediction")
BEFORE_TAKE_OFF = ("import", "Options.__post_init__", *(f"Pilot.{name}" for name in OF_A_CONTROLLER))
BEFORE_TAKE_OFF += ("Rule.init", "Craft.init")
IN_FLIGHT = ("Pilot.step", "Shield.admit", "Air.transmit", "Air.expected", "Craft.step", "Craft.power")
A_ROUND = ("Rule.step",)  # costs that round and no more
FLIGHT = ("--plugin", "mine.py", "--method", "pilot", "--uavs", "2", "--duration", "1", "--no-record", "--quiet")
SETTINGS = ("filter.kind=shield", "federation.aggregation=rule", "radio.model=air", "vehicle.model=craft")


@pytest.mark.parametrize("raised", ["RuntimeError('no')", "SystemExit(0)", "Odd('no')"])
def test_a_command_ends_with_one_error_whatever_a_plugin_raises(run, tmp_path, raised: str) -> None:
    expected = dict.fromkeys(BEFORE_TAKE_OFF, EXIT_BAD_INPUT)
    expected |= dict.fromkeys(IN_FLIGHT, EXIT_RUN_FAILED) | dict.fromkeys(A_ROUND, EXIT_DONE)
    if raised.startswith("Odd"):
        expected = dict.fromkeys(expected, EXIT_RUN_FAILED)
    for method, code in {"nowhere": EXIT_DONE, **expected}.items():
        (tmp_path / "mine.py").write_text(PLUGINS.replace("METHOD", method).replace("RAISED", raised))
        flags = [*FLIGHT, *(flag for setting in SETTINGS for flag in ("--set", setting))]
        ended, _, told = run("run", "--in-process", *flags)
        errors = [line for line in told.splitlines() if line.startswith("error: ")]
        assert (method, ended, len(errors)) == (method, code, int(code != EXIT_DONE)), told
        assert "Traceback" not in told
        assert code == EXIT_DONE or raised.partition("(")[0] in errors[0]
