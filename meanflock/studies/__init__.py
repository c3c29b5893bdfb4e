"""Many flights: scenarios compared and swept, the leaderboard, and the frontier."""
