"""The driving stack without ROS: preprocessing, drivers, policy bundles, sensor monitor, and the safety gate."""
