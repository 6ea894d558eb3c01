"""Bags: writing, reading, and turning them into training episodes. Works without ROS."""
