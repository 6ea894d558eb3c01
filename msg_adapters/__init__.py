"""Pure functions that convert between ROS messages and arrays or dataclasses. No node, no torch, no simulation.

Every function takes a `MessageFactory`, so that the same code fills rclpy messages in the graph and
rosbags messages in the in-process collector.
"""
