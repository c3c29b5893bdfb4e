"""Other people's programs: one script each, run by an interpreter that has that peer and nothing of ours."""
