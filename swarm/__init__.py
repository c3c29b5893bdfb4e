"""What every process of the swarm has in common: states, scenario, messages, bus. No physics, no learning."""

__version__ = "0.1.0"
