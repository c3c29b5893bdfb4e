"""Learners: models of any library that UAVs train in flight, whatever controller flies them."""
