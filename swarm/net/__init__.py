"""The network: one protocol, a bus in memory and one over Zenoh, and what a node says on it."""
