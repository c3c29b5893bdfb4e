"""Controllers that follow trajectories which everybody knows before take-off, and those that learn to."""
