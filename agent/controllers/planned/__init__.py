"""Controllers that follow trajectories known to all UAVs before take-off, or learn to follow them."""
