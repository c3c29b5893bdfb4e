"""Flower apps in flight: ClientApps train on the UAVs, the ServerApp runs in the leader."""
