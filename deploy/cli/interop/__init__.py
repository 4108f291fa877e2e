"""Commands that write files for programs of others: controllers, notebooks, ROS 2."""
