"""Controllers whose UAVs broadcast their states and fly by those of the others: flocking, and avoiding collisions."""
