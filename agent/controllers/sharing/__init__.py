"""Controllers whose UAVs broadcast their states and use those of others: flocking and collision avoidance."""
