"""The paper's figures 2 to 8 and the map of regimes, drawn from the tables."""
