"""What a link does to a message: a channel a file; others are found by name (`swarm/plugins/`)."""
