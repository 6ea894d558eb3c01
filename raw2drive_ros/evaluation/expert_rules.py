"""Right of way at the ego's next junction, as far as signs, lights and the map tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

from raw2drive_ros.evaluation.expert_belief import Belief
from raw2drive_ros.evaluation.expert_map import TURN_RAD, LaneMap
from raw2drive_ros.simulation.right_of_way import main_arms
from raw2drive_ros.simulation.world import World

# A light or sign belongs to the junction that begins within this distance of its line.
OWN_LINE_M = 8.0
OPPOSING_RAD = 2.4


@dataclass(frozen=True, slots=True)
class RightOfWay:
    """junction: the ego's next one, -1 without. heading_rad: of the route where it enters. turn: what the route does
    there. control: '' or what governs the ego: a colour, 'stop' or 'yield'. first: the ego's road has priority."""

    junction: int
    heading_rad: float
    turn: str
    control: str
    first: bool

    def yields_to_ego(self, junction: int, yaw_rad: float, turn: str) -> bool:
        """Whether somebody who enters `junction` with heading `yaw_rad` and makes `turn` has to let the ego pass."""
        if junction != self.junction:
            return False
        apart = abs(math.remainder(yaw_rad - self.heading_rad, 2.0 * math.pi))
        if apart > OPPOSING_RAD:
            return turn == 'left' and self.turn != 'left' and self.control not in ('stop', 'yield', 'red')
        if self.control == 'green':
            return apart > TURN_RAD
        return self.first and apart > TURN_RAD


def right_of_way(world: World, lanes: LaneMap, belief: Belief, front_s_m: float) -> RightOfWay:
    """The rules of the junction that the ego is in or comes to next."""
    span = lanes.next_span(front_s_m - world.ego.LENGTH)
    if span is None:
        return RightOfWay(-1, 0.0, 'ahead', '', first=False)
    enter, leave, junction = span
    heading = world.route.pose(enter)[2]
    turned = world.route.pose(leave)[2] - heading
    turn = 'left' if turned > TURN_RAD else 'right' if turned < -TURN_RAD else 'ahead'
    control = ''
    for i, light in enumerate(world.lights):
        if abs(light.line_s_m - enter) < OWN_LINE_M:
            control = belief.colour(i) or 'unknown'
    for i, sign in enumerate(world.stop_signs):
        if abs(sign.line_s_m - enter) < OWN_LINE_M and i in belief.signs:
            control = 'stop'
    sites = world.road.junctions
    spec = sites[junction].spec if junction < len(sites) else None
    # The ego comes along the chain: from arm `back`.
    first = control == '' and 'back' in main_arms(spec)
    return RightOfWay(junction, heading, turn, control, first=first)
