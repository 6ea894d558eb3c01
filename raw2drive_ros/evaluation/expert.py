"""The expert: plans on what has been visible, and knows no future.

Every decision: what was seen becomes a belief (`expert_belief.py`); others are extrapolated by their lanes
(`expert_prediction.py`); ways along the road (`expert_options.py`) with ways to choose the speed are plans, which are
driven in thought all at once (`expert_plans.py`); the one that is worth most (`expert_costs.py`) is driven. The
decision says why.
"""

from __future__ import annotations

import math

import numpy as np

from raw2drive_ros.contracts.actions import nearest_action
from raw2drive_ros.contracts.public import Control, Decision, Float64, SensorFrame
from raw2drive_ros.evaluation.expert_belief import Belief, Sight
from raw2drive_ros.evaluation.expert_costs import Verdict, judge
from raw2drive_ros.evaluation.expert_map import LaneMap, RouteFrame
from raw2drive_ros.evaluation.expert_options import Option, options
from raw2drive_ros.evaluation.expert_plans import CAP, LEADER, STOP, Plan, Rollouts, plans, roll_out
from raw2drive_ros.evaluation.expert_prediction import DT_S, forecast, hypotheses
from raw2drive_ros.evaluation.expert_rules import right_of_way
from raw2drive_ros.evaluation.expert_situation import (
    AHEAD_M,
    BEHIND_M,
    GRID_BEHIND_M,
    GRID_M,
    HALF_LENGTH_M,
    HALF_WIDTH_M,
    Anchor,
    Situation,
    Zone,
    limits_on,
    own_state,
    zones,
)
from raw2drive_ros.evaluation.following import smooth_pedals, steer_course_to, steer_to
from raw2drive_ros.simulation.environment import DrivingEnv, Tick
from raw2drive_ros.simulation.path import Path
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.rates import DECISION_HZ

STEPS, LONG_DT_S = 27, 0.45
LEAST_PUSH = 0.03
# Standing closer behind an obstacle than this for so long, the ego reverses if nobody is this close behind it.
ROOM_M, STUCK_TICKS, REAR_M, REVERSE_MPS = 7.2, 10, 7.0, 1.2
# It also does so where it stands between the lanes; until it is in its own, or this far back.
ASTRAY_M, LEAST_ROOM_M, MOST_ROOM_M, REVERSE_AHEAD_M = 0.6, 6.0, 20.0, 5.0
# Largest change of the acceleration from one decision to the next, for comfort; harder braking is not limited.
EASE_OFF_MPS2, PRESS_MPS2, HARD_MPS2 = 0.8, 0.4, -3.5
SURPRISE_MPS2 = 2.0
LOOK_AHEAD_M, LOOK_AHEAD_S = 4.0, 0.6


class Expert:
    """One episode's expert. `control(world, sight)` returns (control, why)."""

    def __init__(self) -> None:
        self.belief = Belief()
        self.lanes: LaneMap | None = None
        self.current = 'route'
        self.way: tuple[Float64, Float64] | None = None
        self.anchor: Anchor | None = None
        self.acceleration = 0.0
        self.push = SteeringPush()
        self.backing, self.stuck_ticks = False, 0

    def control(self, world: World, sight: Sight) -> tuple[Control, str]:
        """The command for this decision, and its reason: a rule, and whom it is about."""
        if self.lanes is None:
            self.lanes = LaneMap(world)
            self.limits = limits_on(world, np.arange(*_ends(world.route), GRID_M))
        self.belief.update(world, sight)
        situation = self._situation(world, self.lanes, long=self.current == 'pass')
        situation.anchor = self.anchor
        blocked = zones(situation)
        found = options(situation, blocked)
        if any(option.oncoming for option in found) and situation.forecast.times_s[1] == DT_S:
            situation = self._situation(world, self.lanes, long=True)
            situation.anchor = self.anchor
        chosen = plans(situation, found)
        actual = float(world.ego.acceleration_body[0])
        if abs(actual - self.acceleration) > SURPRISE_MPS2:
            # Somebody else drives, or the road does not let it.
            self.acceleration = actual
        driven = roll_out(situation, found, chosen, self.acceleration)
        verdict = judge(situation, found, chosen, driven, self.way)
        best = int(verdict.score.argmax())
        option = found[chosen[best].option]
        self.current, self.way, self.anchor = option.family, (situation.grid, option.offset), option.anchor
        wanted = float(driven.acceleration[best, 0])
        if wanted > HARD_MPS2:
            wanted = max(wanted, self.acceleration - EASE_OFF_MPS2)
            wanted = min(wanted, max(self.acceleration, 0.0) + PRESS_MPS2)
        self.acceleration = wanted
        if self._backs_up(situation, blocked, found, float(driven.s[best, -1])):
            return self._reverse(situation), f'make room before {blocked[0].name}'
        control = self._command(situation, found[chosen[best].option], self.acceleration)
        return control, reason(situation, found, chosen, driven, verdict, best)

    def _situation(self, world: World, lanes: LaneMap, *, long: bool) -> Situation:
        frame = RouteFrame(world.route, world.route_s_m, BEHIND_M, AHEAD_M)
        s, d, slope, speed = own_state(world, frame)
        rules = right_of_way(world, lanes, self.belief, world.front_s_m)
        times = (LONG_DT_S if long else DT_S) * np.arange(STEPS)
        ego = float(world.ego.position[0]), float(world.ego.position[1])
        view = forecast(hypotheses(self.belief, lanes, rules, float(times[-1]), ego), frame, times)
        grid = math.floor(s) - GRID_BEHIND_M + GRID_M * np.arange(round((GRID_BEHIND_M + AHEAD_M) / GRID_M))
        start = _ends(world.route)[0]
        index = np.minimum(np.maximum(np.rint((grid - start) / GRID_M).astype(np.int64), 0), len(self.limits) - 1)
        return Situation(world, lanes, self.belief, rules, frame, s, d, slope, speed, grid, self.limits[index], view)

    def _backs_up(self, situation: Situation, blocked: list[Zone], found: list[Option], until_m: float) -> bool:
        """Whether the ego stands too close behind an obstacle to steer out, and has room to reverse."""
        ways = any(option.family == 'pass' for option in found)
        room = blocked[0].begin_m - situation.front_m if blocked else math.inf
        astray = abs(situation.d) > ASTRAY_M
        stuck = ways and (room < ROOM_M or (astray and room < LEAST_ROOM_M + ROOM_M))
        stuck &= until_m - situation.s < 1.5 and situation.speed < 0.3
        going_on = self.backing and (room < ROOM_M + 1.5 or abs(situation.d) > 0.6 * ASTRAY_M) and room < MOST_ROOM_M
        view = situation.forecast
        rear = situation.s - HALF_LENGTH_M
        reach = view.half_d[:, :10] + HALF_WIDTH_M + 0.2
        behind = (np.abs(view.d[:, :10] - situation.d) < reach) & (view.s[:, :10] + view.half_s[:, :10] > rear - REAR_M)
        behind &= (view.s[:, :10] < situation.s) & (np.cos(view.turned[:, :10]) > -0.5)
        self.stuck_ticks = self.stuck_ticks + 1 if stuck else 0
        self.backing = (going_on or self.stuck_ticks > STUCK_TICKS) and not bool(behind.any())
        return self.backing

    def _reverse(self, situation: Situation) -> Control:
        """Slowly backwards, to the middle of the ego's lane."""
        self.acceleration = 0.0
        world, speed = situation.world, float(situation.world.ego.speed)
        x, y, _ = world.route.pose(situation.s - REVERSE_AHEAD_M)
        steer = steer_to(world, x, y)
        if speed > 0.2:
            return Control(0.0, 0.5, steer)
        return Control(0.25 if speed > -REVERSE_MPS else 0.05, 0.0, steer, reverse=True)

    def _command(self, situation: Situation, option: Option, acceleration: float) -> Control:
        """Pedals for the acceleration, pure pursuit along the option."""
        world = situation.world
        ahead = situation.s + max(LOOK_AHEAD_M, LOOK_AHEAD_S * situation.speed)
        x, y, _ = world.route.pose(ahead, float(np.interp(ahead, situation.grid, option.offset)))
        steer = min(max(steer_course_to(world, x, y) - self.push.estimate(world), -1.0), 1.0)
        return smooth_pedals(world, acceleration, steer)


class SteeringPush:
    """What turns the wheels besides the ego's own commands, from its wheel angle: the actuator is of first order."""

    def __init__(self) -> None:
        self.wheel = self.deviation = 0.0

    def estimate(self, world: World) -> float:
        """Disturbance of the steering command (share of full lock) over the last decision; call it once in each."""
        ego = world.ego
        keep = math.exp(-1.0 / DECISION_HZ / ego.parameters.steer_time_constant_s)
        self.wheel = keep * self.wheel + (1.0 - keep) * ego.command.steer
        deviation = ego.steer - self.wheel
        push = (deviation - keep * self.deviation) / (1.0 - keep)
        self.deviation = deviation
        return push if abs(push) > LEAST_PUSH else 0.0


def _ends(route: Path) -> tuple[float, float]:
    start = getattr(route, 'start_s_m', 0.0)
    return start, start + route.length_m


def reason(
    situation: Situation, found: list[Option], chosen: list[Plan], driven: Rollouts, verdict: Verdict, best: int
) -> str:
    """Why the best plan is what it is: 'free road', or a rule and whom it is about."""
    plan, names = chosen[best], [h.track.name for h in situation.forecast.hypotheses]
    parts = []
    name = found[plan.option].name
    if name != 'route':
        parts.append(f'{name} of {found[plan.option].about}' if found[plan.option].about else name)
    if plan.brake:
        parts.append('brake hard')
    kind = int(driven.first[best])
    if kind == STOP and plan.why:
        parts.append(plan.why)
    elif kind == LEADER:
        parts.append(f'follow {names[int(driven.leader[best])]}')
    elif kind == CAP:
        parts.append('caution')
    if plan.share < 1.0 or plan.brake:
        # What speaks against the fastest plan on the same way.
        fastest = next(i for i, other in enumerate(chosen) if other.option == plan.option)
        if verdict.worst[fastest] >= 0:
            parts.append(f'{names[int(verdict.worst[fastest])]} in the way')
    return ', '.join(dict.fromkeys(parts)) or ('slow down' if plan.share < 1.0 else 'free road')


class ExpertDriver:
    """The expert as a driver of episodes: reads the map, the ego's own state, and what `env.visibility` has seen."""

    needs_cameras = needs_bev = False

    def reset(self, seed: int) -> None:
        """A new episode begins; the expert itself draws nothing at random."""
        self.expert = Expert()

    def control(self, env: DrivingEnv, frame: SensorFrame, tick: Tick) -> Decision:
        assert env.world is not None
        control, why = self.expert.control(env.world, env.seen())
        return Decision(frame.stamp_ns, control, nearest_action(control), info={'reason': why})
