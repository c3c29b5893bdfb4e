"""How a UAV moves and what that costs: a vehicle a file; others are found by name (`swarm/plugins/`)."""
