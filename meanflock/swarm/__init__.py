"""Code that all processes of the swarm share: states, scenario, plug-ins, events, messages."""

__version__ = "2.0.0"
