"""rclpy lives here and nowhere else; every node is thin around functions that are tested without ROS."""
