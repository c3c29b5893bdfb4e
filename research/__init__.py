"""Research with meanflock: the claims of the paper, and the measurements of the pages. It is no part of the package."""
