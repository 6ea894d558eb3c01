"""CARLA bridge: a car of a CARLA server on the same topics as the simulation bridge, without anything privileged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from msg_adapters.diagnostics import OK, WARN
from msg_adapters.factory import RclpyFactory
from raw2drive_ros.carla_vehicle.client import CarlaSettings, CarlaTick, CarlaVehicle
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.evaluation.tick_messages import IMU_X_M, TickMessages
from raw2drive_ros.nodes.command_wait import CommandWait
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.parameters import declare, wants_compressed
from raw2drive_ros.nodes.quality import LossCounter, make_publisher
from raw2drive_ros.nodes.runtime import run_node, steady_clock
from raw2drive_ros.settings import default_bundle
from raw2drive_ros.tables.rates import DIAGNOSTICS_HZ, ROUTE_EVERY_TICKS

DEFAULTS = CarlaSettings(imu_x_m=IMU_X_M)


class CarlaBridgeNode(Node):
    """Mounts the bundle's cameras at their poses in the bundle, from the middle of the chosen car."""

    def __init__(self) -> None:
        super().__init__('carla_bridge')
        p = declare(
            self,
            {
                'host': (DEFAULTS.host, 'of the CARLA server'),
                'port': (DEFAULTS.port, 'of the CARLA server'),
                'timeout_s': (DEFAULTS.timeout_s, 'how long the server may take to answer'),
                'town': (DEFAULTS.town, 'map to load (default: the one that is loaded)'),
                'vehicle': (DEFAULTS.vehicle, 'blueprint of the car'),
                'spawn_point': (DEFAULTS.spawn_point, 'index of the place to start at'),
                'route_m': (DEFAULTS.route_m, 'length of the route along the lanes'),
                'seed': (DEFAULTS.seed, "of the route's choices at junctions"),
                'bundle': ('', 'policy bundle whose cameras are mounted (default: the shipped one)'),
                'lock_step': (True, 'wait for each command (true) or follow the wall clock (false)'),
                'image_transport': ('raw', 'raw images, or compressed ones (JPEG)'),
                'signed_commands': (True, 'false: obey a gate that cannot sign its commands'),
                'max_ticks': (0, 'end after so many decision ticks; 0: never'),
            },
        )
        compressed = wants_compressed(p['image_transport'])
        rig = load_bundle(Path(p['bundle']) if p['bundle'] else default_bundle()).rig
        names = ('host', 'port', 'timeout_s', 'town', 'vehicle', 'spawn_point', 'route_m', 'seed')
        self.max_ticks = int(p['max_ticks'])
        self.messages = TickMessages(RclpyFactory(), rig, compressed=compressed)
        self.losses = LossCounter()
        self.outputs = {name: make_publisher(self, name) for name in topics.CARLA_BRIDGE_TOPICS}
        self.commands = CommandWait(
            self, self.losses, lock_step=bool(p['lock_step']), signed=bool(p['signed_commands'])
        )
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        # Last: a failure before this leaves nothing on the server, and CarlaVehicle cleans up after its own failures.
        self.vehicle = CarlaVehicle(CarlaSettings(**{name: p[name] for name in names}, imu_x_m=IMU_X_M), rig)
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish, clock=steady_clock())
        if self.vehicle.versions[0] != self.vehicle.versions[1]:
            self.get_logger().warning('client {} and server {} differ'.format(*self.vehicle.versions))

    def run(self, executor: SingleThreadedExecutor) -> None:
        """Tick the server until the context ends or `max_ticks` are driven; the first step brakes fully."""
        tick = self.vehicle.step(Control(brake=1.0))
        for topic, _, message in self.messages.latched(tick.stamp_ns):
            self.outputs[topic].publish(message)
        self.commands.begin()
        ticks = 0
        while rclpy.ok() and (not self.max_ticks or ticks < self.max_ticks):
            self._publish(tick, route=ticks % ROUTE_EVERY_TICKS == 0)
            control = self.commands.wait(tick.stamp_ns, executor, lambda tick=tick: self._publish(tick, route=True))
            tick = self.vehicle.step(control)
            ticks += 1

    def _publish(self, tick: CarlaTick, *, route: bool) -> None:
        clock = self.messages.factory.new('rosgraph_msgs/msg/Clock')
        clock.clock.sec, clock.clock.nanosec = divmod(tick.stamp_ns, 1_000_000_000)
        self.outputs[topics.CLOCK].publish(clock)
        if route:
            topic, _, message = self.messages.route(tick)
            self.outputs[topic].publish(message)
        self.commands.port.report(tick.stamp_ns, tick.sensors.odometry.speed_mps)
        for source in (self.messages.motion(tick), self.messages.cameras(tick)):
            for topic, _, message in source:
                self.outputs[topic].publish(message)

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        level, text, values = self.commands.port.describe()
        if self.losses.total and level == OK:
            level = WARN
        values = {'server': self.vehicle.versions[1], **values, 'messages_lost': self.losses.total}
        return level, text or 'driving', values

    def close(self) -> None:
        self.vehicle.close()


def main(args: list[str] | None = None) -> int:
    """Run the CARLA bridge and return the exit code."""
    return run_node(CarlaBridgeNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
