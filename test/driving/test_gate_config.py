"""`params/gate.yaml`: the shipped file equals the defaults of the classes, and errors name the wrong field."""

import math

import pytest
import yaml

from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.driving.gate_limits import MotionLimits
from raw2drive_ros.driving.gate_state import GateLimits
from raw2drive_ros.settings import params_folder
from raw2drive_ros.simulation.ego import EgoParameters
from raw2drive_ros.timing import load_timing


def test_shipped_stops_are_the_defaults_and_the_car_is_the_simulated_one() -> None:
    config = load_gate_config()
    assert config.gate_limits(load_timing()) == GateLimits()
    motion, car = config.motion_limits(), EgoParameters()
    assert motion.wheelbase_m == car.wheelbase_m == MotionLimits().wheelbase_m
    assert motion.max_steer_rad == car.max_steer_rad == MotionLimits().max_steer_rad
    assert motion.full_throttle_mps2 == car.drive_acceleration_mps2 == MotionLimits().full_throttle_mps2
    assert motion.full_brake_mps2 == car.brake_deceleration_mps2 == MotionLimits().full_brake_mps2


def test_the_example_car_has_its_own_parameters_and_finite_limits() -> None:
    folder = params_folder().parent / 'examples' / 'vehicle_interface'
    motion = load_gate_config(folder / 'gate.yaml').motion_limits()
    car = yaml.safe_load((folder / 'toy_vehicle.yaml').read_text())['vehicle']
    assert motion.wheelbase_m == car['wheelbase_m']
    assert motion.max_steer_rad == car['max_steer_rad']
    assert motion.full_throttle_mps2 == car['throttle_mps2']
    assert motion.full_brake_mps2 == car['brake_mps2']
    assert motion.max_steer_rate_1ps * motion.max_steer_rad <= car['steer_rate_radps']
    assert all(math.isfinite(getattr(motion, name)) for name in motion.__dataclass_fields__)


@pytest.mark.parametrize(
    ('section', 'field', 'value', 'message'),
    [
        ('motion', 'max_speed_mps', -1.0, 'motion.max_speed_mps: Input should be greater than 0'),
        ('motion', 'max_speed_mps', math.nan, 'motion.max_speed_mps'),
        ('motion', 'wheelbase_m', math.inf, 'motion.wheelbase_m'),
        ('motion', 'max_speed', 3.0, 'motion.max_speed: no such key'),
        ('stop', 'emergency_brake', 1.5, 'stop.emergency_brake'),
        ('stop', 'swings', 2.5, 'stop.swings'),
        ('stop', 'emergency_brake', 0.1, 'stop.comfortable_brake is above stop.emergency_brake'),
    ],
)
def test_a_wrong_value_is_named(tmp_path, section, field, value, message) -> None:
    found = yaml.safe_load((params_folder() / 'gate.yaml').read_text())
    found[section][field] = value
    path = tmp_path / 'gate.yaml'
    path.write_text(yaml.safe_dump(found))
    with pytest.raises(ConfigError, match=message):
        load_gate_config(path)
