"""What was measured with meanflock: the paper, claim by claim, and the tables of the pages; no part of the package."""
