"""Who flies a UAV: the base classes of controllers and filters, and a controller a file; families have packages."""
