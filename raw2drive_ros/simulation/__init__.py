"""The world behind the bridge: roads, actors, cameras, BEV masks, reward. numpy and OpenCV only.

The whole simulation is laid out in the REP-103 `map` frame (y to the LEFT, yaw counter-clockwise).
highway-env's planar classes do not care about handedness, so building our own roads y-left removes
every sign change between simulator and ROS.
"""
