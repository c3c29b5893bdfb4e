"""The paper's experiments: the grid as data, many runs at once, and a store that survives what happens to it."""
