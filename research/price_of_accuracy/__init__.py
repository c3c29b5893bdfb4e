"""What 90 % accuracy costs: ways of learning until the swarm has it, for docs/price-of-accuracy.md."""
