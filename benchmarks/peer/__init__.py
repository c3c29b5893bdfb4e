"""Scripts of peers, each run by an interpreter with that peer only, without meanflock."""
