"""The ground station: command line, launcher, and record of a run."""
