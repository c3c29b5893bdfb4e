"""Vehicles: motion of a UAV and its power. Each file has one; others are found by name (`swarm/plugins/`)."""
