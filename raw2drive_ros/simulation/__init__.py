"""The world behind the bridge: roads, actors, cameras, BEV masks, reward. numpy and OpenCV only.

The whole simulation uses the REP-103 `map` frame (y to the LEFT, yaw counter-clockwise). highway-env's planar
classes work in either handedness, so with our own roads in that frame no sign changes between simulator and ROS.
"""
