"""Replay that proves: does a bundle, shown a bag's sensors again, decide what was recorded?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from msg_adapters.commands import decision_from_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros import topics
from raw2drive_ros.contract import Control, SensorFrame
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.driver import RawDriver
from raw2drive_ros.recording.bag_reader import BagError, open_bag, read_ticks


@dataclass(frozen=True, slots=True)
class Verification:
    """compared: decisions that both sides made. text: the verdict for people."""

    equal: bool
    compared: int
    text: str


def recorded_proposals(bag: Path) -> dict[int, Control]:
    """stamp -> control of every proposal in a bag. Raises BagError when it has none."""
    factory = RosbagsFactory()
    found: dict[int, Control] = {}
    with open_bag(bag) as reader:
        connections = [c for c in reader.connections if c.topic == topics.PROPOSED]
        for connection, _, data in reader.messages(connections=connections):
            decision = decision_from_message(factory.deserialize(data, connection.msgtype))
            found[decision.stamp_ns] = decision.control
    if not found:
        raise BagError(f'{bag}: has no {topics.PROPOSED}; record a drive of the raw policy')
    return found


def verify_bag(bag: Path, bundle: Path) -> Verification:
    """Compare bit for bit, and name the first difference."""
    wanted = recorded_proposals(bag)
    driver = RawDriver(load_bundle(bundle))
    compared = differing = left_out = 0
    first = ''
    with open_bag(bag) as reader:
        for tick in read_ticks(reader, bag, cameras=True, privileged=False):
            if tick.stamp_ns not in wanted:
                # The planner was not asked, or found its sensors unfit: its belief did not move on then.
                left_out += 1
                continue
            decision = driver.drive(SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry), tick.route)
            compared += 1
            if decision.control != wanted[tick.stamp_ns]:
                differing += 1
                first = first or (
                    f'first at {tick.stamp_ns * 1e-9:.1f} s: recorded {wanted[tick.stamp_ns]}, now {decision.control}'
                )
    rest = f'; {left_out} ticks have no recorded decision' if left_out else ''
    if differing:
        return Verification(False, compared, f'{differing} of {compared} decisions differ; {first}{rest}')
    return Verification(True, compared, f'{compared} decisions are equal, bit for bit{rest}')
