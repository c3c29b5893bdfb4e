"""Results: files of a run, usable after a kill, and the series, statistics and plots that are made of them."""
