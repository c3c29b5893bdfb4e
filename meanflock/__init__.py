"""Fly a swarm that learns over a metered radio, from Python.

    import meanflock as mf

    run = mf.fly("paper", method="mfgfl-hf", seed=7, duration=60)
    run.summary["arrived"], run.states.shape

Importing this loads nothing and changes nothing; every name is looked up when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from meanflock.agent.controllers.base import Broadcast as Broadcast
    from meanflock.agent.controllers.base import Controller as Controller
    from meanflock.agent.controllers.base import Options as Options
    from meanflock.agent.controllers.base import Received as Received
    from meanflock.agent.controllers.base import Step as Step
    from meanflock.agent.controllers.filtered import Filter as Filter
    from meanflock.channel.base import Channel as Channel
    from meanflock.channel.base import Message as Message
    from meanflock.comparing import compare as compare
    from meanflock.comparing import sweep as sweep
    from meanflock.comparison import Comparison as Comparison
    from meanflock.federation.rules.base import Aggregator as Aggregator
    from meanflock.federation.rules.base import Uploads as Uploads
    from meanflock.flying import fly as fly
    from meanflock.runs import Run as Run
    from meanflock.runs import open_run as open
    from meanflock.stepped import Stepped as Stepped
    from meanflock.swarm import mission as mission
    from meanflock.swarm import seeds as seeds
    from meanflock.swarm.errors import BadInput as BadInput
    from meanflock.swarm.errors import MeanflockError as MeanflockError
    from meanflock.swarm.errors import RunFailed as RunFailed
    from meanflock.swarm.plugins import Plugin as Plugin
    from meanflock.swarm.plugins import installed as plugins
    from meanflock.swarm.plugins import register as register
    from meanflock.swarm.scenario import Scenario as Scenario
    from meanflock.worldsim.vehicles.base import Vehicle as Vehicle

_WHERE = {  # a name → its module, and its name there
    "Aggregator": ("meanflock.federation.rules.base", "Aggregator"),
    "BadInput": ("meanflock.swarm.errors", "BadInput"),
    "Broadcast": ("meanflock.agent.controllers.base", "Broadcast"),
    "Channel": ("meanflock.channel.base", "Channel"),
    "Comparison": ("meanflock.comparison", "Comparison"),
    "Controller": ("meanflock.agent.controllers.base", "Controller"),
    "Filter": ("meanflock.agent.controllers.filtered", "Filter"),
    "MeanflockError": ("meanflock.swarm.errors", "MeanflockError"),
    "Message": ("meanflock.channel.base", "Message"),
    "Options": ("meanflock.agent.controllers.base", "Options"),
    "Plugin": ("meanflock.swarm.plugins", "Plugin"),
    "Received": ("meanflock.agent.controllers.base", "Received"),
    "Run": ("meanflock.runs", "Run"),
    "RunFailed": ("meanflock.swarm.errors", "RunFailed"),
    "Scenario": ("meanflock.swarm.scenario", "Scenario"),
    "Step": ("meanflock.agent.controllers.base", "Step"),
    "Stepped": ("meanflock.stepped", "Stepped"),
    "Uploads": ("meanflock.federation.rules.base", "Uploads"),
    "Vehicle": ("meanflock.worldsim.vehicles.base", "Vehicle"),
    "compare": ("meanflock.comparing", "compare"),
    "fly": ("meanflock.flying", "fly"),
    "mission": ("meanflock.swarm.mission", ""),
    "open": ("meanflock.runs", "open_run"),
    "plugins": ("meanflock.swarm.plugins", "installed"),
    "register": ("meanflock.swarm.plugins", "register"),
    "seeds": ("meanflock.swarm.seeds", ""),
    "sweep": ("meanflock.comparing", "sweep"),
}

__all__ = [  # imported at first use
    "Aggregator",
    "BadInput",
    "Broadcast",
    "Channel",
    "Comparison",
    "Controller",
    "Filter",
    "MeanflockError",
    "Message",
    "Options",
    "Plugin",
    "Received",
    "Run",
    "RunFailed",
    "Scenario",
    "Step",
    "Stepped",
    "Uploads",
    "Vehicle",
    "compare",
    "fly",
    "mission",
    "open",
    "plugins",
    "register",
    "seeds",
    "sweep",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from meanflock.swarm.errors import available

    module, attribute = _WHERE[name]
    with available(f"meanflock.{name}", "ground"):
        found = import_module(module)
    value = getattr(found, attribute) if attribute else found
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *_WHERE})
