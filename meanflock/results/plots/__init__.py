"""Plots of one run, of methods side by side, and of a swept parameter."""
