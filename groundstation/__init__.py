"""Where a person stands: the command line, the launcher, the record of a run, and the paper's experiments."""
