"""Everything that is said between processes, and how it is written."""
