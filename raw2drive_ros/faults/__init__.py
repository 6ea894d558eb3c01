"""Faults on purpose: plans of what goes wrong when, and the injector that makes it so. No ROS in here."""
