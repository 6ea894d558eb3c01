"""The privileged frame: boxes of actors, masks of what was seen, and the signals, with a visibility that tests set."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from raw2drive_ros.contracts.privileged import PIXEL_FIELDS
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.actors import StandingObject
from raw2drive_ros.simulation.bev import BevRenderer
from raw2drive_ros.simulation.draws import Draw
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.privileged_view import PrivilegedView
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.signals import Sign, StopSign, TrafficLight
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.actor_classes import ACTOR_CLASSES
from raw2drive_ros.tables.bev_channels import CHANNELS, HISTORY_TICKS, STATIC_CHANNELS, dynamic_channel
from raw2drive_ros.tables.vector_layout import EGO_FIELDS, LIGHT_FIELDS, SIGNAL_FIELDS, SIGNAL_RANGE_M
from raw2drive_ros.world_model.config import ModelConfig

STATIC = len(STATIC_CHANNELS)
STAND = Control(brake=1.0)


class Eyes:
    """A visibility that is told what was seen. since: by identity of the actor, seconds."""

    def __init__(self, otherwise_s: float = math.inf) -> None:
        self.since: dict[int, float] = {}
        self.otherwise_s = otherwise_s
        self.light_s, self.sign_s = {}, {}

    def pixels(self, actor):
        return np.full(6, 7) if self.seconds_since_seen(actor) == 0.0 else np.zeros(6, int)

    def seconds_since_seen(self, actor) -> float:
        return self.since.get(id(actor), self.otherwise_s)

    def signal_pixels(self):
        return np.arange(60).reshape(10, 6)

    def light_seen_s(self, index: int) -> float:
        return self.light_s.get(index, self.otherwise_s)

    def sign_seen_s(self, index: int) -> float:
        return self.sign_s.get(index, self.otherwise_s)


def a_world(scenario: str = 'LaneFollowing') -> World:
    world = World(get_scenario(scenario), Draw(scenario, 0))
    world.ego.speed = 0.0
    return world


def a_cone(world: World, ahead_m: float, aside_m: float = 0.0) -> StandingObject:
    """Put a cone beside the route, `ahead_m` from the ego's centre, in all of the history."""
    x, y, yaw = world.route.pose(world.route_s_m + ahead_m, aside_m)
    cone = StandingObject(x, y, yaw, 'cone')
    world.add(cone)
    world.history.clear()
    world.refresh()
    return cone


def tick(world: World, view: PrivilegedView, eyes: Eyes, control: Control = STAND):
    """One decision tick later."""
    for _ in range(2):
        world.step(control)
    return view.frame(0, eyes)


def view_of(world: World) -> PrivilegedView:
    return PrivilegedView(world, BevRenderer(world))


def cones(frame, moment: int) -> bool:
    return bool(frame.bev_visible[dynamic_channel('obstacle', moment)].any())


def signals(frame) -> dict[str, float]:
    return dict(zip(SIGNAL_FIELDS, frame.signals.tolist(), strict=True))


# -- actors -------------------------------------------------------------------------------------------


@pytest.mark.parametrize('scenario', ['ConstructionObstacle', 'DynamicObjectCrossing', 'NonSignalizedJunctionLeftTurn'])
def test_every_actor_in_range_is_there_with_its_box_and_its_velocity(scenario) -> None:
    env = DrivingEnv(SimulationConfig(cameras=False))
    env.reset(seed=1, options={'scenario': scenario})
    for _ in range(25):
        env.step(Control(throttle=0.5))
    world, eyes = env.world, Eyes(0.0)
    actors, poses = world.history[0]
    before = {id(actor): actor.position.copy() for actor in actors}
    rows = view_of(world).frame(0, eyes).validate().actors
    ego = world.ego
    near = [i for i, pose in enumerate(poses) if np.hypot(*(pose[:2] - ego.position)) < 100.0]
    assert len(rows) == len(near) + len(world.lights) + len(world.stop_signs) and near
    turn = np.array([[math.cos(ego.heading), math.sin(ego.heading)], [-math.sin(ego.heading), math.cos(ego.heading)]])
    for row, index in zip(rows, near, strict=False):
        actor, pose = actors[index], poses[index]
        assert turn @ (pose[:2] - ego.position) == pytest.approx([row['x'], row['y']], abs=1e-4)
        assert math.remainder(row['yaw_rad'] - (pose[2] - ego.heading), 2 * math.pi) == pytest.approx(0.0, abs=1e-5)
        assert (row['length_m'], row['height_m']) == (np.float32(actor.LENGTH), np.float32(actor.HEIGHT))
        assert row['z'] == pytest.approx(actor.HEIGHT / 2)
        assert [row[name] for name in PIXEL_FIELDS] == [7] * 6
    world.step(STAND)
    for row, index in zip(rows, near, strict=False):
        moved = turn @ (actors[index].position - before[id(actors[index])]) * 20.0
        assert moved == pytest.approx([row['vx_mps'], row['vy_mps']], abs=0.6)


def test_rows_tell_class_intention_and_memory_and_are_in_one_order() -> None:
    world, eyes = a_world(), Eyes()
    near, far = a_cone(world, 12.0, 2.0), a_cone(world, 30.0)
    far.position += 80.0
    world.history.clear()
    world.refresh()
    near.kind, near.indicator, near.braking = 'walker', 'right', True
    eyes.since[id(near)] = 1.5
    view = view_of(world)
    rows = view.frame(0, eyes).validate().actors
    (row,) = rows[rows['class'] == ACTOR_CLASSES.index('walker')]
    assert (row['braking'], row['indicator'], row['since_seen_s']) == (1, -1, 1.5)
    assert (row['x'], row['y']) == pytest.approx((12.0, 2.0), abs=0.05)
    assert all(row[name] == 0 for name in PIXEL_FIELDS)
    assert np.hypot(rows['x'], rows['y']).max() < 100.0 < np.hypot(*(far.position - world.ego.position))
    again = view.frame(0, eyes).actors
    assert again.tobytes() == rows.tobytes()


def test_an_actor_keeps_its_number_when_others_come_and_go() -> None:
    world, eyes = a_world(), Eyes()
    first = a_cone(world, 10.0)
    a_cone(world, 20.0)
    view = view_of(world)

    def number_at(x_m: float) -> int:
        rows = view.frame(0, eyes).actors
        return int(rows['number'][np.abs(rows['x'] - x_m).argmin()])

    numbers = number_at(10.0), number_at(20.0)
    world.actors.remove(first)
    world.refresh()
    assert number_at(20.0) == numbers[1] != numbers[0]
    a_cone(world, 10.0)
    assert number_at(10.0) not in numbers


def test_boxes_project_to_where_the_camera_shows_the_actor() -> None:
    """The pixels that an actor changes lie in its 2-D box, and fill it."""
    env = DrivingEnv(SimulationConfig((224, 400)))
    env.reset(seed=0, options={'scenario': 'LaneFollowing'})
    world = env.world
    world.actors.clear()
    world.refresh()
    without = env.renderer.render()['front'].astype(int)
    x, y, yaw = world.route.pose(world.route_s_m + 14.0, 0.5)
    world.add(StandingObject(x, y, yaw + 0.3, 'van'))
    world.refresh()
    changed = np.abs(env.renderer.render()['front'].astype(int) - without).max(axis=2) > 12
    (row,) = view_of(world).frame(0, Eyes(0.0)).actors
    camera = env.rig[0]
    half = np.array([row['length_m'], row['width_m'], row['height_m']]) / 2
    corners = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * half
    cos, sin = math.cos(row['yaw_rad']), math.sin(row['yaw_rad'])
    corners = corners @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + [row['x'], row['y'], row['z']]
    seen = np.linalg.inv(camera.base_from_camera) @ np.vstack([corners.T, np.ones(8)])
    pixels = camera.intrinsics @ seen[:3]
    u, v = pixels[0] / pixels[2], pixels[1] / pixels[2]
    rows, columns = np.nonzero(changed)
    assert (columns.min(), columns.max()) == pytest.approx((u.min(), u.max()), abs=3.0)
    assert rows.min() == pytest.approx(v.min(), abs=3.0)
    assert rows.max() == pytest.approx(v.max(), abs=5.0), 'the shadow lies a little before it'


# -- masks of what was seen ---------------------------------------------------------------------------


@pytest.mark.parametrize('scenario', ['ConstructionObstacle', 'DynamicObjectCrossing', 'SignalizedJunctionLeftTurn'])
def test_who_sees_everything_has_the_masks_of_everything_and_who_sees_nothing_the_static_ones(scenario) -> None:
    env = DrivingEnv(SimulationConfig(cameras=False))
    env.reset(seed=1, options={'scenario': scenario})
    sharp, blind, all_seen = view_of(env.world), view_of(env.world), Eyes(0.0)
    sharp.frame(0, all_seen)
    drawn = 0
    for _ in range(30):
        env.step(Control(throttle=0.6))
        frame = sharp.frame(0, all_seen).validate()
        # Moments of 0.25 and 0.75 s ago lie between decision ticks: what came then was not seen at the tick before.
        assert not (frame.bev_visible & ~frame.bev).any()
        for moment in (0, 2):
            at = slice(STATIC + moment, None, len(HISTORY_TICKS))
            assert np.array_equal(frame.bev_visible[at], frame.bev[at])
        nothing = blind.frame(0, Eyes())
        assert np.array_equal(nothing.bev_visible[:STATIC], frame.bev[:STATIC])
        assert not nothing.bev_visible[STATIC:].any()
        drawn += frame.bev[STATIC:].any()
    assert drawn, 'there was something to see'


def test_an_actor_that_comes_into_view_is_not_drawn_where_it_was_before() -> None:
    world, eyes = a_world(), Eyes()
    cone = a_cone(world, 10.0)
    view = view_of(world)
    for _ in range(10):
        assert not any(cones(tick(world, view, eyes), moment) for moment in range(4))
    eyes.since[id(cone)] = 0.0
    frames = [tick(world, view, eyes) for _ in range(9)]
    shown = [[cones(frame, moment) for moment in range(4)] for frame in frames]
    # In the masks of 0.25, 0.5 and 0.75 s ago from the first tick on at which it had been seen by then.
    first = [next(n for n in range(9) if shown[n][moment]) for moment in range(4)]
    assert first == [0, 3, 5, 8]


def test_memory_ends_after_two_seconds_and_the_past_stays_what_it_was() -> None:
    world, eyes = a_world(), Eyes()
    cone = a_cone(world, 10.0)
    view = view_of(world)
    for _ in range(10):
        tick(world, view, eyes)
    eyes.since[id(cone)] = 2.0
    assert cones(tick(world, view, eyes), 0)
    eyes.since[id(cone)] = 2.1
    frames = [tick(world, view, eyes) for _ in range(6)]
    assert not any(cones(frame, 0) for frame in frames)
    # Five ticks after it was last drawn as being there now, it is drawn half a second ago.
    assert [cones(frame, 2) for frame in frames] == [False, False, False, False, True, False]


def test_at_the_first_tick_all_moments_are_the_first_one() -> None:
    world, eyes = a_world(), Eyes()
    eyes.since[id(a_cone(world, 10.0))] = 0.0
    frame = view_of(world).frame(0, eyes)
    assert all(cones(frame, moment) for moment in range(4))
    assert np.array_equal(frame.bev_visible, frame.bev)


# -- lights and signs ---------------------------------------------------------------------------------


def with_light(world: World, ahead_m: float, colour: str = 'red') -> TrafficLight:
    """A light whose line is `ahead_m` from the front bumper, on the left of the route behind the line."""
    line = world.front_s_m + ahead_m
    pole = world.route.pose(line + 10.0, 4.0)
    light = TrafficLight(line, ((colour, 600.0),), pole_pose=(pole[0], pole[1], pole[2] + math.pi))
    light.colour = colour
    world.lights.append(light)
    world.light_history.clear()
    world.refresh()
    return light


def test_a_light_is_reported_once_it_was_seen_in_the_colour_in_which_it_was_seen() -> None:
    world, eyes = a_world(), Eyes()
    light = with_light(world, 30.0)
    view = view_of(world)
    unseen = tick(world, view, eyes)
    assert signals(unseen)['light_none'] == 1.0 and signals(unseen)['light_distance_m'] == SIGNAL_RANGE_M
    eyes.light_s[0] = 0.0
    seen = signals(tick(world, view, eyes))
    assert [seen[name] for name in LIGHT_FIELDS] == [0.0, 0.0, 0.0, 1.0]
    assert seen['light_distance_m'] == pytest.approx(30.0, abs=0.01)
    # It turns green behind a truck.
    light.phases, eyes.light_s[0] = (('green', 600.0),), 0.1
    hidden = tick(world, view, eyes)
    assert light.colour == 'green' and signals(hidden)['light_red'] == 1.0
    assert hidden.bev_visible[dynamic_channel('light_red', 0)].any()
    assert not hidden.bev_visible[dynamic_channel('light_green', 0)].any()
    assert hidden.bev[dynamic_channel('light_green', 0)].any()
    eyes.light_s[0] = 2.1
    forgotten = tick(world, view, eyes)
    assert signals(forgotten)['light_none'] == 1.0
    assert not forgotten.bev_visible[dynamic_channel('light_red', 0)].any()
    eyes.light_s[0] = 0.0
    assert signals(tick(world, view, eyes))['light_green'] == 1.0


def test_the_next_light_governs_until_the_bumper_is_past_its_line() -> None:
    world, eyes = a_world(), Eyes(0.0)
    with_light(world, 3.0, 'green')
    with_light(world, 43.0, 'red')
    view = view_of(world)
    first = tick(world, view, eyes)
    assert signals(first)['light_green'] == 1.0 and signals(first)['light_distance_m'] == pytest.approx(3.0, abs=0.01)
    kinds = [ACTOR_CLASSES[row['class']] for row in first.actors]
    assert kinds.count('light_green') == kinds.count('light_red') == 1
    light = first.actors[[kind == 'light_green' for kind in kinds]][0]
    ahead = world.ego.LENGTH / 2 + 3.0 + 10.0
    assert [light[name] for name in PIXEL_FIELDS] == list(range(6)), 'those of the first light'
    assert (light['x'], light['y'], light['z']) == pytest.approx((ahead, 4.0, 3.4), abs=0.3)
    world.route_s_m += 4.5
    after = view.frame(0, eyes)
    assert signals(after)['light_red'] == 1.0 and signals(after)['light_distance_m'] == pytest.approx(38.5, abs=0.01)
    assert 'light_green' not in [ACTOR_CLASSES[row['class']] for row in after.actors]


def test_a_sign_that_was_seen_stays_and_tells_when_it_is_obeyed() -> None:
    world, eyes = a_world(), Eyes()
    sign = StopSign(world.front_s_m + 20.0, world.route.pose(world.route_s_m + 22.0, -4.0))
    world.stop_signs.append(sign)
    view = view_of(world)
    assert signals(tick(world, view, eyes))['stop_sign'] == 0.0
    eyes.sign_s[0] = 0.0
    frame = tick(world, view, eyes)
    assert signals(frame)['stop_sign'] == 1.0 and frame.bev_visible[dynamic_channel('stop_sign', 0)].any()
    assert signals(frame)['stop_sign_distance_m'] == pytest.approx(20.0, abs=0.01)
    assert signals(frame)['stop_sign_obeyed'] == 0.0
    assert 'stop_sign' in [ACTOR_CLASSES[row['class']] for row in frame.actors]
    eyes.sign_s[0] = 9.0
    frame = tick(world, view, eyes)
    assert signals(frame)['stop_sign'] == 1.0 and not frame.bev_visible[dynamic_channel('stop_sign', 0)].any()
    sign.obeyed = True
    assert signals(tick(world, view, eyes))['stop_sign_obeyed'] == 1.0
    world.route_s_m += 22.0
    assert signals(view.frame(0, eyes))['stop_sign'] == 0.0


def test_a_yield_sign_of_the_ego_s_own_approach_is_known_from_near() -> None:
    world, eyes = a_world(), Eyes()
    pole = world.route.pose(world.route_s_m + 40.0, -4.0)
    line = world.front_s_m + 52.0
    world.signs = [Sign('yield', pole, 0, 'left'), Sign('stop', pole, 0, 'back')]
    world.ego_crossings = {0: SimpleNamespace(stop_s_m=line)}
    view = view_of(world)
    world.route_s_m += 30.0
    assert signals(view.frame(0, eyes))['yield_sign'] == 0.0
    world.signs.append(Sign('yield', pole, 0, 'back'))
    near = signals(view.frame(0, eyes))
    assert (near['yield_sign'], near['yield_sign_distance_m']) == (1.0, pytest.approx(22.0, abs=0.01))
    world.route_s_m -= 30.0
    assert signals(view.frame(0, eyes))['yield_sign'] == 0.0, '52 m away'


def test_the_speed_limit_is_that_of_the_road() -> None:
    world = a_world()
    assert signals(view_of(world).frame(0, Eyes()))['speed_limit_mps'] == pytest.approx(
        world.scene.layout.speed_limit_mps
    )


# -- ego ----------------------------------------------------------------------------------------------


def test_offset_and_heading_error_are_those_from_the_route_left_positive() -> None:
    world = a_world()
    x, y, yaw = world.route.pose(world.route_s_m + 5.0, 0.75)
    world.ego.position[:], world.ego.heading = (x, y), math.remainder(yaw + 0.2, 2 * math.pi)
    world.ego.speed = 0.0
    world.step(STAND)
    ego = dict(zip(EGO_FIELDS, view_of(world).frame(0).validate().ego.tolist(), strict=True))
    assert ego['lateral_offset_m'] == pytest.approx(0.75, abs=0.02)
    assert ego['heading_error_rad'] == pytest.approx(0.2, abs=0.01)
    assert (ego['speed_mps'], ego['yaw_rate_radps']) == (0.0, 0.0)


def test_without_visibility_there_are_masks_and_the_ego_vector_alone() -> None:
    env = DrivingEnv(SimulationConfig(cameras=False))
    env.reset(seed=0)
    frame = view_of(env.world).frame(5).validate()
    assert frame.ego.shape == (7,) and len(CHANNELS) == len(frame.bev)
    assert (frame.bev_visible, frame.actors, frame.signals) == (None, None, None)


def test_a_model_of_before_reads_the_five_fields_it_was_trained_on() -> None:
    old = ModelConfig(mask_classes={'road': ['road']})
    assert old.ego_fields == EGO_FIELDS[:5] and old.masks == 'all'
