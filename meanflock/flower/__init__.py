"""Flower apps in flight: ClientApps train on the UAVs, the ServerApp runs in the leader."""

CLIENT_FAILED = "the ClientApp failed"  # begins the problem of a training
