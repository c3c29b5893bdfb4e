"""The world: physics, time, measurement, and the clock that all other processes follow."""
