"""The process that a driver class runs in: privileged code is blocked there, and nothing of the simulator is in it.

`python -m raw2drive_ros.driving.driver_host DESCRIPTOR NAME ARGUMENTS`: DESCRIPTOR is an inherited socket, NAME a
`package.module:Class`, ARGUMENTS a JSON table, or null to say only what the class declares. Requests and answers are
JSON; images follow their request as bytes. Answers are never pickled, so that a driver cannot run code in the process
of the simulator.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from raw2drive_ros.contracts.errors import DriverClassError, DriverFailedError
from raw2drive_ros.contracts.public import CameraCalibration, ImuSample, OdometrySample, Route
from raw2drive_ros.driving.driver_class import (
    PRIVILEGED,
    Sensors,
    command_of,
    declared_sensors,
    described,
    find_class,
    make_instance,
    source_hash,
)
from raw2drive_ros.driving.isolation import block_privileged_imports

Message = dict[str, Any]


def main() -> None:
    """Load the class, say what it declares, then answer requests until the other end is closed."""
    block_privileged_imports()
    link, name, arguments = Connection(int(sys.argv[1])), sys.argv[2], json.loads(sys.argv[3])
    try:
        found = find_class(name)
        sensors = declared_sensors(found, name)
        _send(link, {'sensors': sensors, 'source': source_hash(found)})
        if arguments is None or PRIVILEGED in sensors:
            return
        driver = make_instance(found, name, arguments)
    except DriverClassError as error:
        _send(link, {'refused': str(error)})
        return
    _send(link, {'ready': True})
    try:
        Host(link, driver).serve()
    except EOFError:
        return


def _send(link: Connection, message: Message) -> None:
    link.send_bytes(json.dumps(message).encode())


class Host:
    """Answers the requests of one simulator."""

    def __init__(self, link: Connection, driver: Any) -> None:
        self.link, self.driver = link, driver
        self.begun_ns: int | None = None
        # Sent once, or when they change.
        self.calibration: dict[str, CameraCalibration] = {}
        self.route: Route | None = None

    def serve(self) -> None:
        """Raises EOFError when the other end is closed."""
        while True:
            request = json.loads(self.link.recv_bytes())
            images = self._images(request['images']) if 'images' in request else None
            try:
                answer = self._reset(request) if 'seed' in request else self._drive(request, images)
            except DriverFailedError as error:
                answer = {'fault': str(error)}
            except Exception as error:
                answer = {'fault': described(error)}
            _send(self.link, answer)

    def _reset(self, request: Message) -> Message:
        self.begun_ns = None
        if hasattr(self.driver, 'reset'):
            self.driver.reset(request['seed'])
        return {}

    def _images(self, shapes: Mapping[str, list[int]]) -> dict[str, Any]:
        """Fresh, writable arrays; all images follow in one message."""
        data, images, begin = bytearray(self.link.recv_bytes()), {}, 0
        for camera, shape in shapes.items():
            size = int(np.prod(shape))
            images[camera] = np.frombuffer(data, np.uint8, size, begin).reshape(shape)
            begin += size
        return images

    def _drive(self, request: Message, images: dict[str, Any] | None) -> Message:
        stamp_ns = request['stamp_ns']
        self.begun_ns = stamp_ns if self.begun_ns is None else self.begun_ns
        given: dict[str, Any] = {}
        if images is not None:
            self.calibration = {c['name']: _calibration(c) for c in request.get('calibration', ())} or self.calibration
            given |= {'images': images, 'calibration': dict(self.calibration)}
        if 'imu' in request:
            samples = tuple(ImuSample(stamp, tuple(force), tuple(rate)) for stamp, force, rate in request['imu'])
            given |= {'imu': samples[-1], 'imu_samples': samples}
        if 'odometry' in request:
            given['odometry'] = OdometrySample(*request['odometry'])
        if 'route' in request:
            stamp, points = request['route']
            self.route = Route(stamp, np.array(points, np.float64))
        if request['has_route']:
            given['route'] = self.route
        sensors = Sensors(stamp_ns, (stamp_ns - self.begun_ns) * 1e-9, given)
        control, action = command_of(self.driver.drive(sensors))
        values = [float(control.throttle), float(control.brake), float(control.steer), bool(control.reverse)]
        return {'control': values, 'action': action}


def _calibration(record: Message) -> CameraCalibration:
    intrinsics, pose = (np.array(record[name], np.float64) for name in ('intrinsics', 'base_from_camera'))
    return CameraCalibration(record['name'], record['width'], record['height'], intrinsics, pose)


if __name__ == '__main__':
    main()
