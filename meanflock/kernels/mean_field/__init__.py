"""Kernels that only the mean-field methods call: a step of their two networks, and the repulsion from UAVs nearby."""
