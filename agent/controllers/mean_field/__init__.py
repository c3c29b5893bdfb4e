"""The methods of the paper: what their networks are, how they start, and how they learn in flight."""
