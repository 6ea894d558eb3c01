"""Every topic of the graph, declared once: nodes, recorder, tests and `docs/topics.md` read this table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, unique

from raw2drive_ros.tables.rates import DECISION_HZ, DIAGNOSTICS_HZ, PHYSICS_HZ, ROUTE_HZ

CAMERAS = ('front', 'front_left', 'front_right', 'back', 'back_left', 'back_right')

CLOCK = '/clock'
IMU = '/sensing/imu'
ODOMETRY = '/vehicle/odometry'
ROUTE = '/planning/route'
PROPOSED = '/control/proposed'
COMMAND = '/control/command'
STATUS = '/vehicle/status'
AUTONOMY = '/vehicle/autonomy'
BEV = '/privileged/bev'
BEV_VISIBLE = '/privileged/bev_visible'
EGO = '/privileged/ego'
SIGNALS = '/privileged/signals'
ACTORS = '/privileged/actors'
TRANSITION = '/privileged/transition'
ADVICE = '/privileged/advice'
DIAGNOSTICS = '/diagnostics'
IMU_EXTRINSICS = '/sensing/imu/extrinsics'
PRIVILEGED_PREFIX = '/privileged/'
# Of the whole domain, as everywhere in ROS; all other topics belong to the namespace of their node, thus to one car.
SHARED = (CLOCK, DIAGNOSTICS)


def image_topic(camera: str) -> str:
    """Topic of a camera's raw images."""
    return f'/sensing/camera/{camera}/image_raw'


def compressed_topic(camera: str) -> str:
    """Topic of a camera's compressed images: below the raw topic, as image_transport names it."""
    return f'{image_topic(camera)}/compressed'


def camera_info_topic(camera: str) -> str:
    """Topic of a camera's intrinsics."""
    return f'/sensing/camera/{camera}/camera_info'


def extrinsics_topic(camera: str) -> str:
    """Topic of a camera's mounting pose."""
    return f'/sensing/camera/{camera}/extrinsics'


@unique
class Publisher(Enum):
    """Who publishes a topic; the values are what `docs/topics.md` prints, and no code reads them.

    A bridge stands in for the vehicle: every bridge publishes the topics of CLOCK_SOURCE and VEHICLE. Only the
    simulation bridge also publishes those of SIMULATION, which no vehicle can measure. A player can replace either.
    """

    CLOCK_SOURCE = 'bridge or player'
    VEHICLE = 'bridge or vehicle'
    SIMULATION = 'bridge (training only)'
    PLANNER = 'planner'
    GATE = 'safety gate'
    COMMAND_RECEIVER = 'bridge, vehicle or command adapter'
    COLLECTOR = 'collector'
    ANY_NODE = 'every node'


@dataclass(frozen=True, slots=True, kw_only=True)
class QosProfile:
    """QoS that publishers offer and our subscriptions request; the history is always KEEP_LAST.

    reliable: RELIABLE, otherwise BEST_EFFORT. latched: TRANSIENT_LOCAL, otherwise VOLATILE. depth: messages queued for
    a busy subscriber and, where latched, kept for late subscribers. kept: messages that a publisher can send again to a
    subscriber with a deeper queue, such as the recorder, which has missed them; 0: as many as `depth`.
    """

    reliable: bool = True
    latched: bool = False
    depth: int
    kept: int = 0


CLOCK_QOS = QosProfile(depth=10)
CAMERA_QOS = QosProfile(depth=5)
# A second of samples.
MOTION_QOS = QosProfile(depth=20)
LATCHED_QOS = QosProfile(latched=True, depth=1)
# Only the newest command counts for who obeys it, but a recorder that was busy for seconds gets all of them.
COMMAND_QOS = QosProfile(depth=1, kept=50)
STATUS_QOS = QosProfile(depth=5)
# What is signed with the key that launcher, gate, planner and vehicle share: docs/security.md.
SIGNED = (PROPOSED, COMMAND, STATUS)
PRIVILEGED_QOS = QosProfile(depth=5)
DIAGNOSTICS_QOS = QosProfile(depth=10)

# Rate of topics that are published once, and again on every change.
ON_CHANGE = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicSpec:
    """One row: message type, rate in Hz (or ON_CHANGE), QoS, publisher, and what it carries (prose for the document).

    optional: not always present: it replaces another topic when a parameter says so, exists in collected bags only, or
    came later than bags that are still read.
    stamped: the message begins with a stamp, its own or that of its header.
    """

    name: str
    msgtype: str
    rate_hz: float
    qos: QosProfile
    publisher: Publisher
    carries: str
    optional: bool = False
    stamped: bool = True

    @property
    def privileged(self) -> bool:
        return self.name.startswith(PRIVILEGED_PREFIX)


def _camera_rows(camera: str) -> tuple[TopicSpec, ...]:
    optical = f'camera_{camera}_optical'
    return (
        TopicSpec(
            name=image_topic(camera),
            msgtype='sensor_msgs/msg/Image',
            rate_hz=DECISION_HZ,
            qos=CAMERA_QOS,
            publisher=Publisher.VEHICLE,
            carries=f'rgb8, frame `{optical}`; one stamp for all cameras of a tick',
        ),
        TopicSpec(
            name=compressed_topic(camera),
            msgtype='sensor_msgs/msg/CompressedImage',
            rate_hz=DECISION_HZ,
            qos=CAMERA_QOS,
            publisher=Publisher.VEHICLE,
            carries='JPEG or PNG in place of the raw image (parameter `image_transport`)',
            optional=True,
        ),
        TopicSpec(
            name=camera_info_topic(camera),
            msgtype='sensor_msgs/msg/CameraInfo',
            rate_hz=DECISION_HZ,
            qos=CAMERA_QOS,
            publisher=Publisher.VEHICLE,
            carries='plumb_bob with zero distortion; same stamp as its image',
        ),
        TopicSpec(
            name=extrinsics_topic(camera),
            msgtype='geometry_msgs/msg/TransformStamped',
            rate_hz=ON_CHANGE,
            qos=LATCHED_QOS,
            publisher=Publisher.VEHICLE,
            carries=f'pose of `{optical}` in `base_link`',
        ),
    )


TOPICS: tuple[TopicSpec, ...] = (
    TopicSpec(
        name=CLOCK,
        msgtype='rosgraph_msgs/msg/Clock',
        rate_hz=PHYSICS_HZ,
        qos=CLOCK_QOS,
        publisher=Publisher.CLOCK_SOURCE,
        carries='simulated time',
    ),
    *(row for camera in CAMERAS for row in _camera_rows(camera)),
    TopicSpec(
        name=IMU,
        msgtype='sensor_msgs/msg/Imu',
        rate_hz=PHYSICS_HZ,
        qos=MOTION_QOS,
        publisher=Publisher.VEHICLE,
        carries='specific force and angular velocity in `imu_link` (REP-145)',
    ),
    TopicSpec(
        name=IMU_EXTRINSICS,
        msgtype='geometry_msgs/msg/TransformStamped',
        rate_hz=ON_CHANGE,
        qos=LATCHED_QOS,
        publisher=Publisher.VEHICLE,
        carries='pose of `imu_link` in `base_link`',
    ),
    TopicSpec(
        name=ODOMETRY,
        msgtype='nav_msgs/msg/Odometry',
        rate_hz=PHYSICS_HZ,
        qos=MOTION_QOS,
        publisher=Publisher.VEHICLE,
        carries='pose in `map`, twist in `base_link`',
    ),
    TopicSpec(
        name=ROUTE,
        msgtype='nav_msgs/msg/Path',
        rate_hz=ROUTE_HZ,
        qos=LATCHED_QOS,
        publisher=Publisher.VEHICLE,
        carries='sparse route checkpoints in `map`; a new header stamp means a new route',
    ),
    TopicSpec(
        name=PROPOSED,
        msgtype='sensor_msgs/msg/JointState',
        rate_hz=DECISION_HZ,
        qos=COMMAND_QOS,
        publisher=Publisher.PLANNER,
        carries='named actuators: throttle, brake [0, 1], steer [-1, 1] left positive, reverse; input stamp; signed',
    ),
    TopicSpec(
        name=COMMAND,
        msgtype='sensor_msgs/msg/JointState',
        rate_hz=DECISION_HZ,
        qos=COMMAND_QOS,
        publisher=Publisher.GATE,
        carries='the same fields after the gate, and `activation`; signed; the only topic a vehicle obeys',
    ),
    TopicSpec(
        name=STATUS,
        msgtype='sensor_msgs/msg/JointState',
        rate_hz=DECISION_HZ,
        qos=STATUS_QOS,
        publisher=Publisher.COMMAND_RECEIVER,
        carries='speed, whether the vehicle has stopped by itself, the newest `activation` it heard; signed',
        optional=True,
    ),
    TopicSpec(
        name=AUTONOMY,
        msgtype='std_msgs/msg/Bool',
        rate_hz=ON_CHANGE,
        qos=LATCHED_QOS,
        publisher=Publisher.COMMAND_RECEIVER,
        carries='whether the car obeys commands; false: its driver has taken over, and the gate hands over (latched)',
        optional=True,
        stamped=False,
    ),
    TopicSpec(
        name=BEV,
        msgtype='sensor_msgs/msg/CompressedImage',
        rate_hz=DECISION_HZ,
        qos=PRIVILEGED_QOS,
        publisher=Publisher.SIMULATION,
        carries='43 x 128 x 128 masks, one bit each, packed per channel',
    ),
    TopicSpec(
        name=BEV_VISIBLE,
        msgtype='sensor_msgs/msg/CompressedImage',
        rate_hz=DECISION_HZ,
        qos=PRIVILEGED_QOS,
        publisher=Publisher.SIMULATION,
        carries='the same masks, the dynamic ones only of what the cameras have shown within the last 2 s',
        optional=True,
    ),
    TopicSpec(
        name=EGO,
        msgtype='sensor_msgs/msg/JointState',
        rate_hz=DECISION_HZ,
        qos=PRIVILEGED_QOS,
        publisher=Publisher.SIMULATION,
        carries='ego vector as named values; lateral offset and heading error from the route are missing in old bags',
    ),
    TopicSpec(
        name=SIGNALS,
        msgtype='sensor_msgs/msg/JointState',
        rate_hz=DECISION_HZ,
        qos=PRIVILEGED_QOS,
        publisher=Publisher.SIMULATION,
        carries='light and signs that govern the ego, as far as seen, and the speed limit, as named values',
        optional=True,
    ),
    TopicSpec(
        name=ACTORS,
        msgtype='sensor_msgs/msg/PointCloud2',
        rate_hz=DECISION_HZ,
        qos=PRIVILEGED_QOS,
        publisher=Publisher.SIMULATION,
        carries='a point per actor, light and sign: class, box, velocity, pixels per camera, seconds since seen',
        optional=True,
    ),
    TopicSpec(
        name=TRANSITION,
        msgtype='sensor_msgs/msg/JointState',
        rate_hz=DECISION_HZ,
        qos=PRIVILEGED_QOS,
        publisher=Publisher.SIMULATION,
        carries='action, reward and its terms, is_first, is_terminal, is_last; frame_id holds scenario/seed',
    ),
    TopicSpec(
        name=ADVICE,
        msgtype='sensor_msgs/msg/JointState',
        rate_hz=DECISION_HZ,
        qos=PRIVILEGED_QOS,
        publisher=Publisher.COLLECTOR,
        carries='action that the expert would take now, whoever drives (`collect --advice`); frame_id holds its reason',
        optional=True,
    ),
    TopicSpec(
        name=DIAGNOSTICS,
        msgtype='diagnostic_msgs/msg/DiagnosticArray',
        rate_hz=DIAGNOSTICS_HZ,
        qos=DIAGNOSTICS_QOS,
        publisher=Publisher.ANY_NODE,
        carries='state, rates, ages, messages lost',
    ),
)
BY_NAME = {spec.name: spec for spec in TOPICS}


def published_by(*publishers: Publisher) -> tuple[str, ...]:
    """Names of the topics of these publishers, in the order of the table."""
    return tuple(spec.name for spec in TOPICS if spec.publisher in publishers)


SENSOR_TOPICS = published_by(Publisher.VEHICLE)
CARLA_BRIDGE_TOPICS = published_by(Publisher.CLOCK_SOURCE, Publisher.VEHICLE)
BRIDGE_TOPICS = published_by(Publisher.CLOCK_SOURCE, Publisher.VEHICLE, Publisher.SIMULATION)


def markdown_table() -> str:
    """The table of `docs/topics.md`."""
    lines = ['| topic | type | rate (Hz) | QoS | publisher | carries |', '|---|---|---|---|---|---|']
    for spec in TOPICS:
        rate = f'{spec.rate_hz:g}' if spec.rate_hz else 'latched'
        quality = 'reliable' if spec.qos.reliable else 'best effort'
        quality += (', transient local' if spec.qos.latched else '') + f', depth {spec.qos.depth}'
        quality += f' (publisher {spec.qos.kept})' if spec.qos.kept else ''
        lines.append(
            f'| `{spec.name}` | {spec.msgtype.replace("/msg/", "/")} | {rate} | {quality} '
            f'| {spec.publisher.value} | {spec.carries} |'
        )
    return '\n'.join(lines)
