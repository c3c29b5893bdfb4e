"""Topologies: the ways that the models of a round take between UAVs."""
