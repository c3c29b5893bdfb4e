"""Channels: latency and loss of a message on a link. Each file has one; others are found by name (`swarm/plugins/`)."""
