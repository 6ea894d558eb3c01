"""A car of a CARLA server: its sensors in our contract's frames and units, our commands in its. No ROS here.

The package `carla` (extra `carla`) is imported by `client` only, when a server is wanted.
"""
