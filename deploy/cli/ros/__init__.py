"""Commands that write files for ROS 2."""
