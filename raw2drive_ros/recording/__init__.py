"""Bags: writing, reading, checking, editing and recovering them. Works without ROS."""
