"""The run folder: what a flight leaves on disk, complete at the end and usable if it is killed."""
