"""Controllers and filters: their base classes, and one controller a file. Families of controllers are packages."""
