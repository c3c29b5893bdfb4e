"""Whatever a plug-in raises in whichever method, the command ends with its exit code and one line of error."""

import pytest

from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED

PLUGINS = """
import numpy as np

import meanflock as mf


class Odd(BaseException):
    pass


def in_(method):
    if method == "METHOD":
        raise RAISED


in_("import")


class Pilot(mf.Controller):
    name = "pilot"
    parameters = 2
    period_ticks = 4

    class Options(mf.Options, frozen=True):
        def __post_init__(self):
            in_("__post_init__")

    def __init__(self, options, scenario):
        super().__init__(options, scenario)
        in_("__init__")

    @property
    def weights(self):
        in_("weights")

    def init(self, uavs, plan):
        in_("init")
        return {"model": np.zeros((len(uavs), 2))}

    def step(self, memory, tick, own, received):
        in_("step")
        return mf.Step(memory, -0.02 * own[:, :2], broadcasts=[mf.Broadcast(own)])

    def get(self, memory):
        return memory["model"]

    def set(self, memory, rows, models):
        return memory

    def prediction(self):
        in_("prediction")

class Shield(mf.Filter):
    name = "shield"

    def admit(self, own, others, uavs, wanted):
        in_("admit")
        return wanted, np.zeros((len(own), 0))


class Rule(mf.Aggregator):
    name = "rule"

    def init(self, parameters):
        in_("rule.init")
        return {}

    def step(self, state, uploads):
        in_("rule.step")
        return state, uploads.models.mean(axis=0)


class Air(mf.Channel):
    name = "air"

    def transmit(self, distance_m, bits, rng):
        in_("transmit")
        return np.ones(len(distance_m), np.int64), np.ones(len(distance_m), bool)

    def expected(self, distance_m, bits):
        in_("expected")


class Craft(mf.Vehicle):
    name = "craft"

    def init(self, uavs):
        in_("craft.init")
        return {}

    def step(self, states, hidden, acceleration, noise):
        in_("craft.step")
        return states.copy(), hidden

    def power(self, states, hidden, acceleration):
        in_("power")
        return np.zeros(len(states))
"""
BEFORE_TAKE_OFF = ("import", "__post_init__", "__init__", "weights", "init", "prediction", "rule.init", "craft.init")
IN_FLIGHT = ("step", "admit", "transmit", "expected", "craft.step", "power")
A_ROUND = ("rule.step",)  # costs that round and no more
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
