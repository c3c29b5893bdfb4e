"""A flown flight in the files of other tools: MCAP for Foxglove, and bags of ROS 2."""
