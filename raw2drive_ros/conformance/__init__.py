"""Does a graph that claims to be a vehicle keep the contract? Judges what a probe has seen; no ROS in here."""
