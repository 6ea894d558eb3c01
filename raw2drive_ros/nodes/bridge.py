"""Simulation bridge: publishes all topics of every tick and applies the commands to the simulated car.

Lock-step: waits for the command with the tick's stamp; reproducible, and faster than real time.
Real time: paced by the wall clock; commands may come late, as on a car.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections import deque
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from msg_adapters.commands import decision_to_message
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.factory import RclpyFactory
from raw2drive_ros.artifact import write_whole
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import NodeError, UnknownScenarioError, UnknownWeatherError
from raw2drive_ros.contracts.public import Decision
from raw2drive_ros.driving.single_writer import Sender
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import as_received, driver_seed, result_of
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.results import append_row
from raw2drive_ros.evaluation.statistics import timing_of
from raw2drive_ros.evaluation.suites import limits_of_text
from raw2drive_ros.evaluation.tick_messages import TickMessages
from raw2drive_ros.nodes.command_wait import CommandWait
from raw2drive_ros.nodes.diagnostics import DiagnosticsPublisher
from raw2drive_ros.nodes.keys import load_key
from raw2drive_ros.nodes.parameters import declare, wants_compressed
from raw2drive_ros.nodes.quality import LossCounter, make_publisher, publisher_count
from raw2drive_ros.nodes.runtime import run_node
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig, Tick
from raw2drive_ros.simulation.protocol import PAIRS, PROTOCOLS
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.weather import CLEAR, get_weather
from raw2drive_ros.tables.rates import DECISION_HZ, DIAGNOSTICS_HZ, ROUTE_EVERY_TICKS
from raw2drive_ros.timing import load_timing

# Nodes that subscribe to odometry and to no other sensor topic.
ODOMETRY_ONLY = ('safety_gate', 'command_adapter')
PARAMETERS: dict[str, tuple[Any, str]] = {
    'episodes': ('', 'comma list of TYPE/SEED[/WEATHER[/REPETITION]]; empty: endless, see scenario'),
    'time_limits': ('', "comma list of ROUTE=SECONDS; episodes that are not in it have their scene's own limit"),
    'scenario': ('LaneFollowing', 'scenario type for ~/reset and for endless driving'),
    'seed': (0, 'seed for ~/reset and for endless driving'),
    'weather': (CLEAR, 'weather for ~/reset and for endless driving'),
    'sim_driver': ('', 'a driver that reads the simulation and proposes commands in place of a planner'),
    'sim_driver_run': ('', 'stage-1 run of sim driver privileged'),
    'bench2drive_compat': (False, 'efficiency and comfort as Bench2Drive computes them'),
    'protocol': (PAIRS, f'rules that drives are judged by: {" or ".join(PROTOCOLS)}'),
    'lock_step': (True, 'wait for each command (true) or follow the wall clock (false)'),
    'image_height': (96, 'camera image height in pixels'),
    'image_width': (160, 'camera image width in pixels'),
    'image_transport': ('raw', 'raw images, or compressed ones (JPEG)'),
    'bev': (True, 'publish privileged BEV masks'),
    'wait_for_sensor_subscribers': (
        1,
        'start when every sensor topic has so many subscribers (a sim driver counts as one); 0: at once',
    ),
    'result_file': ('', 'write results as JSON here when all episodes are driven'),
    'rows_file': ('', 'append a JSON line per finished episode here'),
    'progress_file': ('', 'append one JSON line per second of simulated time here'),
    'loop': (False, 'begin the list of episodes again when it is driven'),
    'signed_commands': (True, 'false: obey a gate that cannot sign; then anybody in the ROS domain can drive the car'),
    'max_ticks': (0, 'cut every episode after so many ticks; 0: never'),
}


class BridgeNode(Node):
    """Parameters: `PARAMETERS`; services: ~/reset, ~/pause."""

    def __init__(self) -> None:
        super().__init__('bridge')
        p = declare(self, PARAMETERS, live={'scenario': get_scenario, 'seed': _whole_number, 'weather': get_weather})
        self.p = p
        self.timing = load_timing()
        if p['image_height'] <= 0 or p['image_width'] <= 0:
            raise NodeError('image_height and image_width must be positive')
        self.compressed = wants_compressed(p['image_transport'])
        self.queue = _parse_episodes(p['episodes'])
        self.limits_s = limits_of_text(p['time_limits'])
        self.endless = not self.queue or bool(p['loop'])
        self.sim_driver = _sim_driver(p['sim_driver'], p['sim_driver_run'])
        cameras = self.sim_driver is None or self.sim_driver.needs_cameras
        if p['protocol'] not in PROTOCOLS:
            raise NodeError(f'protocol: {p["protocol"]!r} is not {" or ".join(PROTOCOLS)}')
        size = (p['image_height'], p['image_width'])
        config = SimulationConfig(size, cameras=cameras, bev=p['bev'], end_on_infraction=False, protocol=p['protocol'])
        self.env = DrivingEnv(config)
        self.messages = TickMessages(RclpyFactory(), self.env.rig, compressed=self.compressed)
        self.losses = LossCounter()
        self.commands = CommandWait(
            self, self.losses, lock_step=bool(p['lock_step']), signed=bool(p['signed_commands'])
        )
        self.outputs: dict[str, Any] = {name: make_publisher(self, name) for name in topics.BRIDGE_TOPICS}
        if self.sim_driver is not None:
            self.outputs[topics.PROPOSED] = make_publisher(self, topics.PROPOSED)
        self.proposals = Sender(topics.PROPOSED, load_key(self.context.get_domain_id()))
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.diagnostics = DiagnosticsPublisher(self, self._describe)
        self.create_timer(1.0 / DIAGNOSTICS_HZ, self.diagnostics.publish)
        self.reset_to: RouteId | None = None
        self.proposed: Decision | None = None
        self.paused = False
        # Bounded, and small where driving is endless: a buffer that fills for hours looks like a leak.
        self.tick_ms: deque[float] = deque(maxlen=10_000 if self.endless else 100_000)
        self.recent_ms: deque[float] = deque(maxlen=50)
        self.results: deque[dict[str, Any]] = deque(maxlen=1 if self.endless else None)
        self.episode = ''
        self.tick_started = 0.0

    # -- main loop --------------------------------------------------------------------------------

    def run(self, executor: SingleThreadedExecutor) -> None:
        """Drive all episodes; returns when they are done."""
        self.executor_ = executor
        self._check_alone()
        self._wait_for_peers()
        for topic, _, message in self.messages.latched(self.env.clock_ns + 1):
            self.outputs[topic].publish(message)
        seed = int(self.p['seed'])
        index = 0
        while self.endless or index < len(self.queue):
            if self.queue:
                route = self.queue[index % len(self.queue)]
            else:
                route = RouteId(self.p['scenario'], seed + index, self.p['weather'])
            if self.reset_to is not None:
                route, self.reset_to = self.reset_to, None
            self._drive(route, index)
            index += self.reset_to is None
        # A destroyed publisher drops what was not acknowledged yet.
        for publisher in self.outputs.values():
            publisher.wait_for_all_acked(Duration(seconds=1))
        self._write_results()

    def _drive(self, route: RouteId, index: int) -> None:
        tick, _ = self.env.reset_to(route, self.limits_s.get(route))
        self.episode = str(route)
        if self.sim_driver is not None:
            self.sim_driver.reset(driver_seed(route))
        self._publish_route(tick)
        ticks = 0
        # The first status after this tells a gate with the parameter `simulated` that the car was put elsewhere.
        self.commands.begin()
        limit = int(self.p['max_ticks'])
        while not self.env.done and (not limit or ticks < limit):
            self.tick_started = time.perf_counter()
            self._publish(tick)
            if self.sim_driver is not None:
                self._propose(self.sim_driver.control(self.env, as_received(self.messages.factory, tick), tick))
            control = self.commands.wait(
                tick.stamp_ns,
                self.executor_,
                lambda tick=tick: self._publish_again(tick),
                lambda: self.reset_to is not None,
            )
            while self.paused:
                self.executor_.spin_once(timeout_sec=0.1)
            if self.reset_to is not None:
                return
            tick, *_ = self.env.step(control)
            ticks += 1
            self.recent_ms.append((time.perf_counter() - self.tick_started) * 1e3)
            self.tick_ms.append(self.recent_ms[-1])
            if ticks % DECISION_HZ == 0:
                self._progress(index, ticks)
            if ticks % ROUTE_EVERY_TICKS == 0:
                self._publish_route(tick, wait=False)
        self._publish(tick)
        result = result_of(self.env, bench2drive_compat=self.p['bench2drive_compat'])
        self.results.append(result.to_json())
        if self.p['rows_file']:
            append_row(Path(self.p['rows_file']), result)
        self._progress(index, ticks, done=True)

    def _publish_again(self, tick: Tick) -> None:
        self._publish_route(tick)
        self._publish(tick)
        if self.proposed is not None:
            self._propose(self.proposed)

    # -- publishing -------------------------------------------------------------------------------

    def _publish_route(self, tick: Tick, *, wait: bool = True) -> None:
        """wait: until subscribers have acknowledged it, so that a new route precedes the first image of its episode."""
        topic, _, message = self.messages.route(tick)
        publisher = self.outputs[topic]
        publisher.publish(message)
        if wait:
            publisher.wait_for_all_acked(Duration(seconds=2))

    def _publish(self, tick: Tick) -> None:
        clock = self.messages.factory.new('rosgraph_msgs/msg/Clock')
        clock.clock.sec, clock.clock.nanosec = divmod(tick.stamp_ns, 1_000_000_000)
        self.outputs[topics.CLOCK].publish(clock)
        self.commands.port.report(tick.stamp_ns, tick.sensors.odometry.speed_mps)
        for source in (
            self.messages.motion(tick),
            self.messages.privileged(tick, self.episode),
            self.messages.cameras(tick),
        ):
            for topic, _, message in source:
                self.outputs[topic].publish(message)

    def _propose(self, decision: Decision) -> None:
        numbered = dataclasses.replace(decision, sequence=self.proposals.next())
        message = decision_to_message(self.messages.factory, numbered)
        self.outputs[topics.PROPOSED].publish(self.proposals.sign(message))
        self.proposed = decision

    # -- callbacks --------------------------------------------------------------------------------

    def _on_reset(self, request: Any, response: Any) -> Any:
        """Start over with the parameters `scenario`, `seed` and `weather`."""
        scenario = str(self.get_parameter('scenario').value)
        seed = int(self.get_parameter('seed').value or 0)
        try:
            get_scenario(scenario)
            weather = get_weather(str(self.get_parameter('weather').value)).name
        except (UnknownScenarioError, UnknownWeatherError) as error:
            response.success, response.message = False, str(error)
            return response
        self.p['scenario'], self.p['weather'] = scenario, weather
        self.reset_to = RouteId(scenario, seed, weather)
        response.success, response.message = True, str(self.reset_to)
        return response

    def _on_pause(self, request: Any, response: Any) -> Any:
        self.paused = bool(request.data)
        response.success, response.message = True, 'paused' if self.paused else 'running'
        return response

    def _describe(self) -> tuple[int, str, dict[str, Any]]:
        level, text, values = self.commands.port.describe()
        if self.losses.total and level == OK:
            level = WARN
        values = {'episode': self.episode, **values, 'messages_lost': self.losses.total, 'paused': self.paused}
        return level, text or ('driving' if self.episode else 'waiting for peers'), values

    # -- start and end ----------------------------------------------------------------------------

    def _check_alone(self) -> None:
        """Raises NodeError for a second bridge in the domain, which would mix two simulations."""
        deadline = time.perf_counter() + 1.0
        while time.perf_counter() < deadline:
            self.executor_.spin_once(timeout_sec=0.1)
        if publisher_count(self, topics.CLOCK) > 1:
            domain = os.environ.get('ROS_DOMAIN_ID', '0')
            raise NodeError(
                f'another node publishes {topics.CLOCK} in ROS domain {domain}: '
                'stop it, or choose another domain with ROS_DOMAIN_ID or --domain'
            )

    def _wait_for_peers(self) -> None:
        if int(self.p['wait_for_sensor_subscribers']) <= 0:
            return
        wanted = self._wanted_subscribers()
        deadline = time.perf_counter() + self.timing.discovery_timeout_s
        while missing := self._missing_peer(wanted):
            if time.perf_counter() > deadline:
                if not self.endless:
                    raise NodeError(
                        f'{missing} after {self.timing.discovery_timeout_s:.0f} s: is the planner active and the gate '
                        'running?'
                    )
                self.get_logger().warning(f'{missing} so far; waiting on')
                deadline = time.perf_counter() + self.timing.discovery_timeout_s
            self.executor_.spin_once(timeout_sec=0.1)
        # Planner and gate have to discover each other too, which this node cannot observe.
        deadline = time.perf_counter() + 1.0
        while time.perf_counter() < deadline:
            self.executor_.spin_once(timeout_sec=0.1)

    def _wanted_subscribers(self) -> dict[str, int]:
        """Number of subscribers to wait for, by topic: DDS matches each topic on its own.

        A sim driver replaces the planner: it needs no sensor topic, and its proposals have to reach the gate.
        """
        listeners = int(self.p['wait_for_sensor_subscribers'])
        unused = {topics.IMU_EXTRINSICS}
        unused |= {(topics.image_topic if self.compressed else topics.compressed_topic)(c) for c in topics.CAMERAS}
        sensors = [name for name in topics.SENSOR_TOPICS if name not in unused]
        if self.sim_driver is None:
            return dict.fromkeys(sensors, listeners)
        return dict.fromkeys(sensors, listeners - 1) | {topics.PROPOSED: listeners}

    def _missing_peer(self, wanted: dict[str, int]) -> str:
        """Describes the first peer that is missing; '' when all are there."""
        for name, count in wanted.items():
            if (found := self._listeners(name)) < count:
                return f'{found} of {count} subscribers on {name}'
        return '' if publisher_count(self, topics.COMMAND) else f'no publisher on {topics.COMMAND}'

    def _listeners(self, name: str) -> int:
        """Matched subscribers; on sensor topics without gate and command adapter, which need odometry only."""
        publisher = self.outputs[name]
        found = int(publisher.get_subscription_count())
        if name == topics.PROPOSED:
            return found
        subscribers = self.get_subscriptions_info_by_topic(publisher.topic_name)
        return max(0, found - sum(subscriber.node_name in ODOMETRY_ONLY for subscriber in subscribers))

    def _progress(self, index: int, ticks: int, *, done: bool = False) -> None:
        if not self.p['progress_file']:
            return
        assert self.env.world is not None
        line = {
            'index': index,
            'episode': self.episode,
            'ticks': ticks,
            'completion': self.env.criteria.route_completion(self.env.world),
            'ticks_per_s': timing_of(list(self.recent_ms))['ticks_per_s'],
            'done': done,
        }
        with Path(self.p['progress_file']).open('a') as file:
            file.write(json.dumps(line) + '\n')

    def _write_results(self) -> None:
        if not self.p['result_file']:
            return
        timing = timing_of(list(self.tick_ms), self.losses.total)
        timing['commands_missed'] = self.commands.policy.missed
        write_whole(Path(self.p['result_file']), json.dumps({'routes': list(self.results), 'timing': timing}))


def _whole_number(value: int) -> None:
    if value < 0:
        raise ValueError(f'seed {value}: give 0 or more')


def _sim_driver(name: str, run: str) -> EpisodeDriver | None:
    """Raises NodeError for the raw driver, which is the planner's; UnknownDriverError, CheckpointError."""
    if name == 'raw':
        raise NodeError('sim_driver: the raw driver runs in the planner node')
    return make_driver(name, run=Path(run) if run else None) if name else None


def _parse_episodes(text: str) -> list[RouteId]:
    """'A/1,B/2/FogNoon' -> routes. Raises RouteIdError, UnknownScenarioError or UnknownWeatherError."""
    episodes = [RouteId.parse(part) for part in text.split(',') if part.strip()]
    for route in episodes:
        get_scenario(route.type)
    return episodes


def main(args: list[str] | None = None) -> int:
    """Run the simulation bridge and return the exit code."""
    return run_node(BridgeNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
