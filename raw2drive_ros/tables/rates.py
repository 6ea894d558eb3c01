"""The rates that are part of the design, declared once: not parameters, because models, bags and suites depend on them.

A policy repeats its action for one decision period, the latent model predicts one decision period ahead, and bags and
routes count in these ticks. What can be changed without training again is in `params/timing.yaml`.
"""

from __future__ import annotations

# Decisions, camera images and commands; physics, IMU and odometry.
DECISION_HZ = 10
PHYSICS_HZ = 20
# Physics steps per decision.
SUBSTEPS = PHYSICS_HZ // DECISION_HZ
DECISION_NS = 1_000_000_000 // DECISION_HZ
PHYSICS_NS = 1_000_000_000 // PHYSICS_HZ
# The route is latched; it is repeated for subscribers that missed it.
ROUTE_HZ = 1
ROUTE_EVERY_TICKS = DECISION_HZ // ROUTE_HZ
DIAGNOSTICS_HZ = 1
