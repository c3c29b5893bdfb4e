"""What every process of the swarm agreed on beforehand: state layout, scenario, messages, bus. No physics, no learning."""

__version__ = "0.1.0"
