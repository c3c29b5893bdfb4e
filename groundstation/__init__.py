"""Where a person stands: the command line, the launcher, and the record of a run."""
