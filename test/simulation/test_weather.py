import math
from dataclasses import replace

import numpy as np
import pytest

from raw2drive_ros.contracts.errors import UnknownWeatherError
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.actors import Look, PathVehicle, StandingObject
from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.signals import TrafficLight
from raw2drive_ros.simulation.variation import NO_VARIATION, Variation, picture_rng
from raw2drive_ros.simulation.weather import CLEAR, WEATHER_NAMES, get_weather

NIGHTS = tuple(name for name in WEATHER_NAMES if name.endswith('Night'))


@pytest.fixture(scope='module')
def drawn() -> DrivingEnv:
    env = DrivingEnv(SimulationConfig(bev=False))
    env.reset(seed=0)
    for _ in range(30):
        env.step(Control(0.6))
    return env


@pytest.fixture
def env(drawn) -> DrivingEnv:
    """An empty road in front of the ego, and behind it."""
    drawn.world.actors.clear()
    drawn.world.lights, drawn.world.stop_signs = [], []
    drawn.world.refresh()
    return drawn


def view(
    env: DrivingEnv, weather: str = CLEAR, variation: Variation = NO_VARIATION, camera: str = 'front'
) -> np.ndarray:
    env.renderer.new_world(env.world, get_weather(weather), variation)
    return env.renderer.render()[camera].astype(int)


def car_picture(env: DrivingEnv, ahead_m: float, weather: str, colour: int = 0) -> np.ndarray:
    world = env.world
    world.actors = [PathVehicle(world.route, world.route_s_m + ahead_m, 5.0, 5.0, look=Look('sedan', colour))]
    world.refresh()
    return view(env, weather)


def light_picture(env: DrivingEnv, ahead_m: float, colour: str, weather: str) -> np.ndarray:
    world = env.world
    x, y, yaw = world.route.pose(world.route_s_m + ahead_m, -3.0)
    world.lights = [TrafficLight(50.0, ((colour, 1.0),), pole_pose=(x, y, yaw + math.pi))]
    return view(env, weather)


@pytest.mark.parametrize('name', [name for name in WEATHER_NAMES if name != CLEAR])
def test_every_weather_differs_from_clear_noon(env, name) -> None:
    clear, other = view(env), view(env, name)
    assert np.abs(other - clear).mean() > 2.0
    assert other.std() > 8.0


def test_an_unknown_weather_is_refused() -> None:
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False))
    with pytest.raises(UnknownWeatherError, match='Drizzle'):
        env.reset(options={'weather': 'Drizzle'})


def test_clear_noon_without_variation_adds_no_noise_and_draws_nothing(env) -> None:
    rng = np.random.default_rng(5)
    state = rng.bit_generator.state
    env.renderer.new_world(env.world, rng=rng)
    first, second = env.renderer.render(), env.renderer.render()
    assert all(np.array_equal(first[name], second[name]) for name in first)
    assert rng.bit_generator.state == state


@pytest.mark.parametrize('name', ['SoftRainNoon', 'HardRainNight', 'ClearNight'])
def test_rain_and_noise_fall_elsewhere_in_every_frame(env, name) -> None:
    first = view(env, name)
    assert (np.abs(env.renderer.render()['front'] - first) > 0).mean() > 0.2


@pytest.mark.parametrize('name', ['FogNoon', 'FogSunset'])
def test_fog_hides_a_far_car_more_than_a_near_one(env, name) -> None:
    def contrast(ahead_m: float, weather: str) -> float:
        white, black = (car_picture(env, ahead_m, weather, colour) for colour in (2, 3))
        return float((white - black).max())

    def kept(ahead_m: float) -> float:
        return contrast(ahead_m, name) / contrast(ahead_m, name.replace('Fog', 'Cloudy'))

    visibility_m = get_weather(name).fog_m
    assert kept(8.0) == pytest.approx(math.exp(-8.0 / visibility_m), abs=0.08)
    assert kept(45.0) == pytest.approx(math.exp(-45.0 / visibility_m), abs=0.08)


@pytest.mark.parametrize(('row', 'distance_m'), [(90, 1.6 * 114 / 42.5), (53, 1.6 * 114 / 5.5)])
def test_fog_lies_over_the_ground_as_far_as_it_is(env, row, distance_m) -> None:
    fog, cloudy = (view(env, name)[row, 70:90] for name in ('FogNoon', 'CloudyNoon'))
    weather = get_weather('FogNoon')
    kept = np.mean(weather.sky_horizon - fog) / np.mean(weather.sky_horizon - cloudy)
    assert kept == pytest.approx(math.exp(-distance_m / weather.fog_m), abs=0.06)


@pytest.mark.parametrize('name', WEATHER_NAMES)
def test_red_can_be_told_from_green_at_15_m(env, name) -> None:
    red, green = (light_picture(env, 15.0, colour, name) for colour in ('red', 'green'))
    differs = np.abs(red - green).max(axis=2) > 60
    assert differs.sum() >= 8
    assert (red - green)[differs][:, 0].max() > 80
    assert (green - red)[differs][:, 1].max() > 80


@pytest.mark.parametrize('name', WEATHER_NAMES)
def test_a_car_25_m_ahead_can_be_seen(env, name) -> None:
    # The rain falls alike in both pictures.
    empty, full = view(env, name), car_picture(env, 25.0, name)
    assert (np.abs(full - empty).max(axis=2) > 25).sum() >= 12


@pytest.mark.parametrize('name', WEATHER_NAMES)
def test_the_lane_near_the_car_can_be_seen(env, name) -> None:
    """Paint and asphalt of the lowest rows, where the lane's edges are."""
    rows = view(env, name)[70:].mean(axis=2)
    assert np.percentile(rows, 99) - np.median(rows) > 25


@pytest.mark.parametrize('name', WEATHER_NAMES)
def test_without_lamps_too_a_car_12_m_behind_can_be_seen(env, name) -> None:
    world = env.world
    empty = view(env, name, camera='back')
    x, y, yaw = world.route.pose(world.route_s_m - 12.0)
    world.actors = [StandingObject(x, y, yaw, 'parked', Look('sedan', 4))]
    world.refresh()
    assert (np.abs(view(env, name, camera='back') - empty).max(axis=2) > 12).sum() >= 10


@pytest.mark.parametrize('name', NIGHTS)
def test_at_night_only_what_shines_is_bright(env, name) -> None:
    sky_and_sides = view(env, name)
    assert np.median(sky_and_sides) < 60
    lit = light_picture(env, 10.0, 'red', name)
    assert lit[..., 0].max() > 180
    assert (lit[..., 0] > 180).sum() > (sky_and_sides[..., 0] > 180).sum()


def test_head_lights_reach_ahead_and_not_behind(env) -> None:
    env.renderer.new_world(env.world, get_weather('ClearNight'))
    night = {name: image[64:].mean() for name, image in env.renderer.render().items()}
    env.renderer.new_world(env.world)
    noon = {name: image[64:].mean() for name, image in env.renderer.render().items()}
    assert night['front'] / noon['front'] > 1.5 * night['back'] / noon['back']


def test_head_lights_shine_on_what_stands_ahead(env) -> None:
    world = env.world
    x, y, yaw = world.route.pose(world.route_s_m + 10.0)
    world.actors = [StandingObject(x, y, yaw, 'barrier')]
    world.refresh()
    night = replace(get_weather('ClearNight'), noise=0.0)
    means = []
    for weather in (night, replace(night, headlights=0.0)):
        env.renderer.new_world(world, weather)
        means.append(env.renderer.render()['front'][62:68, 76:84].mean())
    assert means[0] > 1.3 * means[1]


def drive(seed: int, repetition: int, weather: str = CLEAR, *, vary: bool = False) -> list[np.ndarray]:
    env = DrivingEnv(SimulationConfig(bev=False, vary=vary))
    tick, _ = env.reset(seed=seed, options={'weather': weather, 'repetition': repetition})
    ticks = [tick, env.step(Control(0.3))[0]]
    return [image for tick in ticks for image in tick.sensors.images.values()]


@pytest.mark.parametrize('weather', [CLEAR, 'MidRainNight'])
def test_pictures_are_those_of_the_route_and_its_repetition(weather) -> None:
    first, again, other = drive(2, 1, weather), drive(2, 1, weather), drive(2, 2, weather)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_a_variation_belongs_to_type_seed_and_repetition_whatever_the_weather() -> None:
    def drawn(*route) -> Variation:
        return Variation.draw(picture_rng(RouteId(*route)), 6)

    kinds = [
        ('Accident', 1),
        ('Accident', 2),
        ('ParkedObstacle', 1),
        ('Accident', 1, CLEAR, 1),
        ('Accident', 1, CLEAR, 2),
    ]
    assert len({drawn(*route) for route in kinds}) == len(kinds)
    assert drawn('Accident', 1) == drawn('Accident', 1, 'FogNoon')


def test_episodes_vary_if_asked_to() -> None:
    plain, varied, again = drive(2, 0), drive(2, 0, vary=True), drive(2, 0, vary=True)
    assert all(np.array_equal(a, b) for a, b in zip(varied, again, strict=True))
    assert all(np.abs(a.astype(int) - b).mean() > 1.0 for a, b in zip(plain, varied, strict=True))


def test_a_moved_camera_changes_the_picture_and_not_what_is_published(env) -> None:
    turn = (0.0, 0.0, math.radians(2.0))
    moved = Variation(mounting=((turn, (0.0, 0.0, 0.0)),) * len(env.rig))
    plain, turned = view(env), view(env, variation=moved)
    published = camera_rig()
    for camera, nominal in zip(env.rig, published, strict=True):
        assert np.array_equal(camera.base_from_camera, nominal.base_from_camera)
    # 2 degrees to the left move the picture 4 pixels to the right.
    columns = slice(10, 150)
    shifted = np.abs(turned[60:90, 14:154] - plain[60:90, columns]).mean()
    assert shifted < 0.5 * np.abs(turned[60:90, columns] - plain[60:90, columns]).mean()
    view(env)
    assert np.array_equal(view(env), plain)


@pytest.mark.parametrize(
    ('change_of', 'expected'),
    [({'exposure': 1.2}, 1.2), ({'exposure': 0.8}, 0.8), ({'asphalt': 1.3}, None), ({'line_wear': 1.0}, None)],
)
def test_parts_of_a_variation(env, change_of, expected) -> None:
    plain, varied = view(env), view(env, variation=Variation(**change_of))
    road = (slice(75, 96), slice(40, 120))
    if expected:
        assert varied[road].mean() / plain[road].mean() == pytest.approx(expected, abs=0.03)
    elif 'asphalt' in change_of:
        assert np.median(varied[road]) / np.median(plain[road]) == pytest.approx(1.3, abs=0.1)
        assert np.array_equal(varied[:40], plain[:40])
    else:
        assert varied[70:].max() < 0.85 * plain[70:].max()


@pytest.mark.parametrize('name', [name for name in WEATHER_NAMES if 'Rain' in name])
def test_rain_is_seen(env, name) -> None:
    """Streaks stand out, and they fall: the next picture has others."""
    rainy = get_weather(name)
    pictures = []
    for rain in (rainy.rain, 0.0):
        env.renderer.new_world(env.world, replace(rainy, rain=rain))
        pictures.append([env.renderer.render()['front'].astype(int) for _ in range(2)])
    (first, second), (dry, _) = pictures
    # The noise falls alike in both pictures.
    streaks = (first - dry).min(axis=2) > 10
    assert streaks.mean() > 0.3 * rainy.rain
    assert (second - first).max() > 10
