"""Processes of a ROS graph on this machine: starting, driving and ending them. No rclpy here: it is in `nodes`."""
