"""Plots: of one run, of methods side by side, of a parameter swept."""
