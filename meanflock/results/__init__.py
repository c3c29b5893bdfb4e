"""Files of a run: written during the flight, complete at its end, and usable after a kill."""
