"""The vehicle's side: the last command is held, then the car brakes."""

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.driving.command_policy import CommandPolicy

WANTED = Control(0.5, 0.0, 0.2)


def test_missing_commands_are_held_and_then_braked() -> None:
    policy = CommandPolicy(0.3, 0.6)
    assert policy.missing(0).brake == 0.6
    policy.accept(WANTED, 1_000_000_000)
    assert not policy.expired(1_300_000_000)
    assert policy.expired(1_300_000_001)
    assert policy.missing(1_200_000_000) == WANTED
    stopping = policy.missing(1_400_000_000)
    assert (stopping.throttle, stopping.brake, stopping.steer) == (0.0, 0.6, 0.2)
    assert policy.missed == 3


def test_a_braking_car_keeps_its_gear() -> None:
    policy = CommandPolicy(0.3, 0.6)
    policy.accept(Control(0.5, 0.0, 0.2, reverse=True), 0)
    assert policy.missing(1_000_000_000) == Control(0.0, 0.6, 0.2, reverse=True)
