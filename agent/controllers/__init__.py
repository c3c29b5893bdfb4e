"""Who flies a UAV: the base class of every controller, and a controller a file."""
