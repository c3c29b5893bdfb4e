"""The ground station as a program of its own: it records a swarm that was started otherwise."""
