"""The names of the Python API, each with its module. `__init__.py` reads this file, too."""

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
from meanflock.federation.rules.base import Aggregate as Aggregate
from meanflock.federation.rules.base import Aggregator as Aggregator
from meanflock.federation.rules.base import Uploads as Uploads
from meanflock.flying import fly as fly
from meanflock.runs import Run as Run
from meanflock.runs import open_run
from meanflock.stepped import Stepped as Stepped
from meanflock.swarm import mission as mission
from meanflock.swarm import seeds as seeds
from meanflock.swarm.errors import BadInput as BadInput
from meanflock.swarm.errors import MeanflockError as MeanflockError
from meanflock.swarm.errors import RunFailed as RunFailed
from meanflock.swarm.plugins import Plugin as Plugin
from meanflock.swarm.plugins import installed
from meanflock.swarm.plugins import register as register
from meanflock.swarm.scenario import Scenario as Scenario
from meanflock.worldsim.vehicles.base import Vehicle as Vehicle

open = open_run
plugins = installed
