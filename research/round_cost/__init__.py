"""What a round costs: ways of averaging on several radios and kinds of access, for docs/round-cost.md."""
