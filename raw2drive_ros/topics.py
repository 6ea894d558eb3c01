"""Every topic of the graph, declared once: nodes, recorder, tests and `docs/topics.md` read this table."""

from __future__ import annotations

from dataclasses import dataclass

CAMERAS = ('front', 'front_left', 'front_right', 'back', 'back_left', 'back_right')

CLOCK = '/clock'
IMU = '/sensing/imu'
ODOMETRY = '/vehicle/odometry'
ROUTE = '/planning/route'
PROPOSED = '/control/proposed'
COMMAND = '/control/command'
BEV = '/privileged/bev'
EGO = '/privileged/ego'
TRANSITION = '/privileged/transition'
ADVICE = '/privileged/advice'
DIAGNOSTICS = '/diagnostics'
IMU_EXTRINSICS = '/sensing/imu/extrinsics'
PRIVILEGED_PREFIX = '/privileged/'


def image_topic(camera: str) -> str:
    return f'/sensing/camera/{camera}/image_raw'


def compressed_topic(camera: str) -> str:
    """Beside the raw topic, where image_transport puts it."""
    return f'{image_topic(camera)}/compressed'


def camera_info_topic(camera: str) -> str:
    return f'/sensing/camera/{camera}/camera_info'


def extrinsics_topic(camera: str) -> str:
    return f'/sensing/camera/{camera}/extrinsics'


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """One row: rate in Hz (0 = on change), QoS (reliable, latched, depth), publisher, and what it carries.

    optional: not always there: in place of another topic when a parameter says so, or in collected bags only.
    """

    name: str
    msgtype: str
    rate_hz: float
    reliable: bool
    latched: bool
    depth: int
    publisher: str
    carries: str
    optional: bool = False

    @property
    def privileged(self) -> bool:
        return self.name.startswith(PRIVILEGED_PREFIX)


def _camera_rows(camera: str) -> tuple[TopicSpec, ...]:
    optical = f'camera_{camera}_optical'
    return (
        TopicSpec(
            image_topic(camera),
            'sensor_msgs/msg/Image',
            10,
            True,
            False,
            5,
            'bridge or vehicle',
            f'rgb8, frame `{optical}`; one stamp for all cameras of a tick',
        ),
        TopicSpec(
            compressed_topic(camera),
            'sensor_msgs/msg/CompressedImage',
            10,
            True,
            False,
            5,
            'bridge or vehicle',
            'JPEG or PNG in place of the raw image (parameter `image_transport`)',
            optional=True,
        ),
        TopicSpec(
            camera_info_topic(camera),
            'sensor_msgs/msg/CameraInfo',
            10,
            True,
            False,
            5,
            'bridge or vehicle',
            'plumb_bob with zero distortion; same stamp as its image',
        ),
        TopicSpec(
            extrinsics_topic(camera),
            'geometry_msgs/msg/TransformStamped',
            0,
            True,
            True,
            1,
            'bridge or vehicle',
            f'pose of `{optical}` in `base_link`',
        ),
    )


TOPICS: tuple[TopicSpec, ...] = (
    TopicSpec(CLOCK, 'rosgraph_msgs/msg/Clock', 20, True, False, 10, 'bridge or player', 'simulated time'),
    *(row for camera in CAMERAS for row in _camera_rows(camera)),
    TopicSpec(
        IMU,
        'sensor_msgs/msg/Imu',
        20,
        True,
        False,
        20,
        'bridge or vehicle',
        'specific force and angular velocity in `imu_link` (REP-145)',
    ),
    TopicSpec(
        IMU_EXTRINSICS,
        'geometry_msgs/msg/TransformStamped',
        0,
        True,
        True,
        1,
        'bridge or vehicle',
        'pose of `imu_link` in `base_link`',
    ),
    TopicSpec(
        ODOMETRY,
        'nav_msgs/msg/Odometry',
        20,
        True,
        False,
        20,
        'bridge or vehicle',
        'pose in `map`, twist in `base_link`',
    ),
    TopicSpec(
        ROUTE,
        'nav_msgs/msg/Path',
        1,
        True,
        True,
        1,
        'bridge or vehicle',
        'sparse route checkpoints in `map`; a new header stamp means a new route',
    ),
    TopicSpec(
        PROPOSED,
        'sensor_msgs/msg/JointState',
        10,
        True,
        False,
        1,
        'planner',
        'named actuators: throttle, brake [0, 1], steer [-1, 1] left positive, reverse; stamp of the input',
    ),
    TopicSpec(
        COMMAND,
        'sensor_msgs/msg/JointState',
        10,
        True,
        False,
        1,
        'safety gate',
        'the same fields after the gate; the only topic a vehicle obeys',
    ),
    TopicSpec(
        BEV,
        'sensor_msgs/msg/CompressedImage',
        10,
        True,
        False,
        5,
        'bridge (training only)',
        '43 x 128 x 128 masks, one bit each, packed per channel',
    ),
    TopicSpec(
        EGO, 'sensor_msgs/msg/JointState', 10, True, False, 5, 'bridge (training only)', 'ego vector as named values'
    ),
    TopicSpec(
        TRANSITION,
        'sensor_msgs/msg/JointState',
        10,
        True,
        False,
        5,
        'bridge (training only)',
        'action, reward and its terms, is_first, is_terminal, is_last; frame_id holds scenario/seed',
    ),
    TopicSpec(
        ADVICE,
        'sensor_msgs/msg/JointState',
        10,
        True,
        False,
        5,
        'collector',
        'action that the expert would take now, whoever drives (`raw2drive collect --advice`)',
        optional=True,
    ),
    TopicSpec(
        DIAGNOSTICS,
        'diagnostic_msgs/msg/DiagnosticArray',
        1,
        True,
        False,
        10,
        'every node',
        'state, rates, ages, messages lost',
    ),
)
BY_NAME = {spec.name: spec for spec in TOPICS}
SENSOR_TOPICS = tuple(spec.name for spec in TOPICS if spec.name.startswith(('/sensing', '/vehicle', '/planning')))


def markdown_table() -> str:
    """The table of `docs/topics.md`."""
    lines = ['| topic | type | rate (Hz) | QoS | publisher | carries |', '|---|---|---|---|---|---|']
    for spec in TOPICS:
        rate = f'{spec.rate_hz:g}' if spec.rate_hz else 'latched'
        quality = 'reliable' if spec.reliable else 'best effort'
        quality += (', transient local' if spec.latched else '') + f', depth {spec.depth}'
        lines.append(
            f'| `{spec.name}` | {spec.msgtype.replace("/msg/", "/")} | {rate} | {quality} '
            f'| {spec.publisher} | {spec.carries} |'
        )
    return '\n'.join(lines)
