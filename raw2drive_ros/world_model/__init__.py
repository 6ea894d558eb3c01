"""World model and policy in torch: encoders, RSSM, heads, actor-critic. No ROS, no simulation.

docs/shapes.md explains the letters of shapes.
"""
