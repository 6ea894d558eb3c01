"""Looking at one drive: a picture of the scene and of what the cameras see, or a video of the whole drive."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from raw2drive_ros.contracts.public import Control, Decision
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.metrics import RouteResult
from raw2drive_ros.evaluation.table_actions import reason_of
from raw2drive_ros.report.overview import Overview
from raw2drive_ros.report.panels import Rgb, canvas_of, mp4, plot_controls, put, put_mosaic, text
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig, Tick
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.world import World
from raw2drive_ros.tables.bev_channels import CHANNELS
from raw2drive_ros.tables.bev_colours import colour_masks
from raw2drive_ros.tables.rates import DECISION_HZ

SECONDS = 6.0
GAP, TILE = 12, (320, 192)
BEV_PX = 2 * TILE[1]
WIDTH = 3 * GAP + 3 * TILE[0] + BEV_PX
FILM = (1280, 720)
FRONT, SMALL, CROP = (800, 480), (266, 120), 20
OUTCOME_FRAMES = 12
GOOD, BAD = (110, 220, 140), (255, 130, 110)


def bev_picture(tick: Tick) -> Rgb:
    """(H, W, 3) RGB of the BEV masks; the tick must have privileged data."""
    assert tick.privileged is not None
    return colour_masks(tick.privileged.bev.astype(np.float32), list(CHANNELS))


def outcome_of(result: RouteResult) -> str:
    """One line for people."""
    events = ', '.join(f'{name} x{count}' for name, count in result.infractions.items()) or 'no infraction'
    return f'driving score {result.driving_score:.1f}, {result.route_completion:.0f} % of the route, {events}'


def save_picture(
    target: Path,
    route: RouteId,
    image_size: tuple[int, int],
    driver: EpisodeDriver,
    seconds: float = SECONDS,
) -> Path:
    """A PNG: the scene from above at its start, then cameras and BEV after `seconds`. Raises OSError."""
    env = _watched_env(image_size)
    begin: list[World] = []
    trail: list[tuple[float, float]] = []
    last: list[Tick] = []
    decided: list[Decision] = []

    def on_tick(tick: Tick, decision: Decision) -> None:
        assert env.world is not None
        if not begin:
            begin.append(env.world.fork())
        trail.append((float(env.world.ego.position[0]), float(env.world.ego.position[1])))
        last[:], decided[:] = [tick], [decision]

    drive_route(env, driver, route, on_tick, max_ticks=round(seconds * DECISION_HZ) + 1)
    tick = last[0]
    scene = Overview(begin[0], WIDTH).draw(trail)
    head, below = canvas_of(WIDTH, 44), canvas_of(WIDTH, BEV_PX + 34)
    text(head, str(route), (GAP, 18), 0.55)
    text(head, env.world.scenario.description if env.world else '', (GAP, 36))
    why = reason_of(decided[0]) and f': {reason_of(decided[0])}'
    when = f'after {(len(trail) - 1) / DECISION_HZ:.1f} s, at {tick.sensors.odometry.speed_mps * 3.6:.0f} km/h{why}'
    text(below, when, (GAP, 15))
    put_mosaic(below, tick.sensors.images, GAP, 22, TILE)
    put(below, bev_picture(tick), WIDTH - GAP - BEV_PX, 22, BEV_PX, BEV_PX, smooth=False)
    target.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(target), np.vstack([head, scene, below])[..., ::-1]):
        raise OSError(f'{target}: cannot be written')
    return target


def save_film(
    target: Path,
    route: RouteId,
    image_size: tuple[int, int],
    driver: EpisodeDriver,
    seconds: float | None = None,
) -> RouteResult:
    """Write an MP4 of the drive at its own speed, to its end or for `seconds`; returns its result. Raises OSError."""
    env = _watched_env(image_size)
    history: list[Control] = []
    reward = 0.0
    target.parent.mkdir(parents=True, exist_ok=True)
    with mp4(target, *FILM, DECISION_HZ) as append:
        picture = canvas_of(*FILM)

        def on_tick(tick: Tick, decision: Decision) -> None:
            nonlocal picture, reward
            history.append(decision.control)
            reward += tick.transition.reward
            picture = _film_picture(tick, history, str(route), reward, reason_of(decision))
            append(picture)

        ticks = None if seconds is None else max(1, round(seconds * DECISION_HZ))
        result = drive_route(env, driver, route, on_tick, ticks).result
        picture[-26:, : FRONT[0]] = 0
        ending = 'ended' if env.done else 'cut'
        text(picture, f'{ending}: {outcome_of(result)}', (GAP, FILM[1] - 9), 0.5, GOOD if result.success else BAD)
        for _ in range(OUTCOME_FRAMES):
            append(picture)
    return result


def _watched_env(image_size: tuple[int, int]) -> DrivingEnv:
    return DrivingEnv(SimulationConfig(image_size, end_on_infraction=False))


def _film_picture(tick: Tick, history: list[Control], title: str, reward: float, reason: str) -> Rgb:
    canvas = canvas_of(*FILM)
    put(canvas, tick.sensors.images['front'], 0, 0, *FRONT)
    put_mosaic(canvas, tick.sensors.images, 0, FRONT[1], SMALL, crop=CROP)
    left = FRONT[0] + 2 * GAP
    text(canvas, title, (left, 18), 0.5)
    speed = tick.sensors.odometry.speed_mps * 3.6
    status = f'{(len(history) - 1) / DECISION_HZ:5.1f} s   {speed:5.1f} km/h   reward {reward:+8.1f}'
    text(canvas, f'{status}  ({tick.transition.reward:+.2f})', (left, 38))
    put(canvas, bev_picture(tick), left, 48, BEV_PX, BEV_PX, smooth=False)
    plot_controls(canvas, history, left, 48 + BEV_PX + GAP)
    text(canvas, reason, (GAP, FILM[1] - 9), 0.5)
    return canvas
