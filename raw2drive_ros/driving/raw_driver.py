"""The raw policy as a `Driver`: planner node, in-process evaluator and bag replay all call `RawDriver.drive`."""

from __future__ import annotations

import time

import numpy as np
import torch
from numpy.typing import NDArray

from raw2drive_ros.contracts.actions import ACTIONS
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Decision, Route, SensorFrame
from raw2drive_ros.driving.bundle import Bundle
from raw2drive_ros.driving.continuity import follows
from raw2drive_ros.driving.preprocessing import RouteProgress, raw_vector
from raw2drive_ros.world_model.agent import AgentState, Observation, RecurrentAgent


class RawDriver:
    """The raw policy, deterministic: modes of posterior and actor instead of samples, `threads` torch threads.

    A new route (another stamp) and time that goes back start a new episode. A gap (`continuity.follows`) starts a new
    sequence in it: the recurrent state from before is stale, as in training, and the place along the route is not.
    """

    name = 'raw'

    def __init__(self, bundle: Bundle, threads: int = 1) -> None:
        self.bundle = bundle
        self.cameras = [camera.name for camera in bundle.rig]
        torch.set_num_threads(threads)
        self.agent = RecurrentAgent(bundle.model, bundle.actor)
        self.reset()

    def reset(self) -> None:
        self.progress = RouteProgress()
        self.state: AgentState = self.agent.initial()
        self.stamp_ns: int | None = None

    def drive(self, frame: SensorFrame, route: Route) -> Decision:
        """Raises ContractError when a camera is missing or has the wrong size, or when the policy's output is not
        finite."""
        started = time.perf_counter()
        new_route = self.progress.route is not None and route.stamp_ns != self.progress.route.stamp_ns
        back = self.stamp_ns is not None and frame.stamp_ns < self.stamp_ns
        if new_route or back:
            self.reset()
        elif not follows(self.stamp_ns, frame.stamp_ns):
            self.state = self.agent.initial()
        self.stamp_ns = frame.stamp_ns
        self.progress.update(route, frame.odometry)
        images = torch.from_numpy(self._stack(frame))
        vector = torch.from_numpy(raw_vector(frame.imu, frame.odometry, self.progress))[None]
        choice, state = self.agent.step(Observation(images, vector), self.state)
        if not choice.log_probs.isfinite().all():
            # The state that led there is poisoned: it is dropped, and nothing is proposed.
            raise ContractError('the policy gave probabilities that are not finite')
        self.state = state
        action = int(choice.action)
        probability = float(choice.log_probs[0, action].exp())
        elapsed_ms = (time.perf_counter() - started) * 1e3
        return Decision(frame.stamp_ns, ACTIONS[action], action, elapsed_ms, info={'probability': probability})

    def _stack(self, frame: SensorFrame) -> NDArray[np.uint8]:
        """(1, views, H, W, 3) uint8 in the bundle's order of cameras."""
        height, width = self.bundle.config.image_size
        images = []
        for camera in self.cameras:
            image = frame.images.get(camera)
            if image is None:
                raise ContractError(f'camera {camera} is missing from the frame')
            if image.shape != (height, width, 3):
                raise ContractError(
                    f'camera {camera}: image {image.shape[0]}x{image.shape[1]}, the bundle needs {height}x{width}'
                )
            images.append(image)
        return np.stack(images)[None]

    def reconstruct(self) -> NDArray[np.float32]:
        """(C*P*P, G, G) mask probabilities decoded from the current state: for videos, not for driving."""
        return np.asarray(self.agent.reconstruct(self.state)[0])
