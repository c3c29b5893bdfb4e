"""A UAV's computer: the controller that flies it, and the node that runs it as rows of one process."""
