"""Bridges: a flight in the protocols of other software, while it is flown or played."""
