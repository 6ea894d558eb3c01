"""Fault injection: plans of which fault happens when, and the injector that applies them. No ROS here."""
