"""Our client: real errors of CARLA's client without a server, and its calls against a stand-in for a server."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

carla = pytest.importorskip('carla', reason='extra carla')

import stand_in  # noqa: E402 (needs carla)

from raw2drive_ros.carla_vehicle import client  # noqa: E402
from raw2drive_ros.contracts.errors import SensorTimeoutError  # noqa: E402
from raw2drive_ros.contracts.public import Control  # noqa: E402
from raw2drive_ros.simulation.camera_rig import camera_rig  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def world(monkeypatch):
    world = stand_in.World()
    monkeypatch.setattr(stand_in.Client, 'world', world)
    types = ('Location', 'Rotation', 'Transform', 'VehicleControl')
    package = SimpleNamespace(Client=stand_in.Client, **{name: getattr(carla, name) for name in types})
    monkeypatch.setattr(client, 'import_carla', lambda: package)
    return world


def test_without_a_server_there_is_one_line_and_exit_code_1() -> None:
    command = [
        sys.executable,
        '-m',
        'raw2drive_ros.cli.main',
        'carla',
        '--port',
        '9',
        '--timeout',
        '0.5',
        '--domain',
        '91',
    ]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert 'no CARLA server at localhost:9: time-out of 500ms' in result.stderr
    assert 'Traceback' not in result.stderr


def test_two_ticks_a_step_frames_stamps_and_route(world) -> None:
    with client.CarlaVehicle(client.CarlaSettings(route_m=120.0), camera_rig(48, 80)) as vehicle:
        assert (world.settings.synchronous_mode, world.settings.fixed_delta_seconds) == (True, 0.05)
        first, second = vehicle.step(Control(0.5, 0.0, 0.25)), vehicle.step(Control(0.0, 1.0))
        assert second.stamp_ns - first.stamp_ns == 100_000_000
        assert [s.stamp_ns for s in second.imu_samples] == [second.stamp_ns - 50_000_000, second.stamp_ns]
        assert second.sensors.odometry == second.odometry_samples[-1]
        # One physics tick to put it there, two for the step.
        assert (first.sensors.odometry.x_m, first.sensors.odometry.y_m) == pytest.approx((10.75, -20.0))
        assert first.sensors.odometry.speed_mps == 5.0
        assert set(first.sensors.images) == {camera.name for camera in camera_rig()}
        bgra = np.random.default_rng(world.frame - 2).integers(0, 255, (48, 80, 4), np.uint8)
        assert (first.sensors.images['back'] == bgra[..., 2::-1]).all()
        assert first.route.checkpoints_m.tolist() == [[10.0 + 30.0 * i, -20.0] for i in range(5)]
        car = world.actors[0]
        assert car.controls[0].steer == -0.25
        assert car.controls[1].brake == 1.0
        assert float(world.actors[4].blueprint.attributes['fov']) == pytest.approx(110.0)
    assert not any(actor.alive for actor in world.actors)
    assert world.settings.synchronous_mode is False


@pytest.mark.parametrize(
    ('settings', 'words'),
    [
        ({'spawn_point': 1}, 'spawn point 1: this map has 0 to 0'),
        ({'vehicle': 'vehicle.none'}, "this server has no vehicle 'vehicle.none'"),
    ],
)
def test_impossible_settings_leave_the_server_as_it_was(world, settings, words) -> None:
    with pytest.raises(client.CarlaError, match=words):
        client.CarlaVehicle(client.CarlaSettings(**settings), camera_rig(48, 80))
    assert world.settings.synchronous_mode is False
    assert not any(actor.alive for actor in world.actors)


def test_ctrl_c_while_it_spawns_leaves_the_server_as_it_was(world, monkeypatch) -> None:
    spawn = world.spawn_actor

    def interrupted(blueprint, transform, attach_to=None):
        if len(world.actors) == 3:
            raise KeyboardInterrupt
        return spawn(blueprint, transform, attach_to)

    monkeypatch.setattr(world, 'spawn_actor', interrupted)
    with pytest.raises(KeyboardInterrupt):
        client.CarlaVehicle(client.CarlaSettings(), camera_rig(48, 80))
    assert world.settings.synchronous_mode is False
    assert [actor.alive for actor in world.actors] == [False] * 3


def test_an_actor_that_cannot_be_destroyed_does_not_keep_the_others_or_synchronous_mode(world) -> None:
    with client.CarlaVehicle(client.CarlaSettings(), camera_rig(48, 80)):
        world.sticky = 'sensor.other.imu'
    assert [actor.name for actor in world.actors if actor.alive] == ['sensor.other.imu']
    assert world.settings.synchronous_mode is False


def test_a_sensor_that_falls_silent_ends_the_drive_and_is_named(world) -> None:
    with client.CarlaVehicle(client.CarlaSettings(timeout_s=0.2), camera_rig(48, 80)) as vehicle:
        world.silent = 'sensor.other.imu'
        with pytest.raises(SensorTimeoutError, match='from: imu'):
            vehicle.step(Control())
    assert not any(actor.alive for actor in world.actors)
