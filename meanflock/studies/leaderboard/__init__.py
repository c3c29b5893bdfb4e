"""The leaderboard: controllers of every kind over the same missions and seeds, over the same metered radio."""
