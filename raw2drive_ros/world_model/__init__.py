"""World model and policy in torch: encoders, RSSM, heads, actor-critic. No ROS, no simulation.

Shapes: B batch, T time, G grid side of e_t, E features per grid cell, D deterministic state,
S categoricals, K classes each, V vector inputs, A actions, C mask classes, P patch side.
"""
