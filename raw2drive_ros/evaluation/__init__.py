"""Closed-loop evaluation: routes, drivers on them, scores, reports. Simulation inside, no ROS."""
