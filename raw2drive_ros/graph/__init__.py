"""Processes of a ROS graph on this machine: starting, driving and ending them. No rclpy in here; nodes have it."""
