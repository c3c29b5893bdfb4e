"""A flown flight in a file that Foxglove and ROS 2 open."""
