"""The frontier: the fewest bits at which flights are free of collisions, for each controller, loss and density."""
