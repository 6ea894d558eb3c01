"""Stage 1 (privileged) and stage 2 (raw) training from bags. No ROS, no simulation."""
