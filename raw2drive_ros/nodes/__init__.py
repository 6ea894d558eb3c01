"""The only package that imports rclpy; nodes are thin wrappers around functions that are tested without ROS."""
