"""A car on a CARLA server: sensor data and commands converted between CARLA's conventions and our contract. No ROS.

Only `client` imports the package `carla` (extra `carla`), and only when it connects to a server.
"""
