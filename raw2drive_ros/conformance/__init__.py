"""Checks whether a graph that claims to be a vehicle keeps the contract, from what a probe observed; no ROS here."""
