"""Access control for SROS2, generated from the topic table: an enclave per process, which may do what its node does.

Whatever is not allowed here is denied: only the gate's enclave publishes commands, only the operator's requests an
activation, and the planner's hears nothing privileged. The fault injector and the attacker have no enclave.
Format: https://design.ros2.org/articles/ros2_access_control_policies.html, version 0.2.0.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from msg_adapters.vehicle_commands import ADAPTERS
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.topics import Publisher, published_by

VERSION = '0.2.0'
# Of enclaves without a namespace.
ROOT = '/raw2drive'
PARAMETER_SERVICES = (
    'describe_parameters',
    'get_parameter_types',
    'get_parameters',
    'list_parameters',
    'set_parameters',
    'set_parameters_atomically',
)
# What rclpy opens for every node: services below its name, and topics of the whole domain.
NODE_SERVICES = (*PARAMETER_SERVICES, 'get_type_description')
NODE_TOPICS = ('/rosout', '/parameter_events')
LIFECYCLE_SERVICES = (
    'change_state',
    'get_available_states',
    'get_available_transitions',
    'get_state',
    'get_transition_graph',
)
VEHICLE = (Publisher.CLOCK_SOURCE, Publisher.VEHICLE, Publisher.COMMAND_RECEIVER)
EVERYTHING = tuple(topics.BY_NAME)


@dataclass(frozen=True, slots=True, kw_only=True)
class Enclave:
    """What the process of one node may do. node: its name, and that of the enclave.

    publishes, hears: topics of the table. offers: services below the node's name. requests: services of other nodes, as
    'node/service'. other: further topics that it publishes.
    """

    node: str
    publishes: tuple[str, ...] = ()
    hears: tuple[str, ...] = ()
    offers: tuple[str, ...] = ()
    requests: tuple[str, ...] = ()
    other: tuple[str, ...] = ()


def enclaves() -> tuple[Enclave, ...]:
    """Every process that may take part."""
    heard_by_gate = (topics.PROPOSED, topics.ODOMETRY, topics.STATUS, topics.AUTONOMY, topics.CLOCK)
    offers = {
        'safety_gate': ('activate', 'start_over'),
        'bridge': ('reset', 'pause'),
        'planner': LIFECYCLE_SERVICES,
        'recorder': ('save',),
        'player': ('pause', 'step', 'seek'),
    }
    # Of nodes with parameters that may be set while they run.
    set_by_operator = tuple(f'{node}/{name}' for node in ('bridge', 'player') for name in PARAMETER_SERVICES)
    called = tuple(f'{node}/{name}' for node, names in offers.items() for name in names if node != 'planner')
    found = (
        Enclave(node='safety_gate', publishes=published_by(Publisher.GATE), hears=heard_by_gate),
        Enclave(
            node='planner',
            publishes=published_by(Publisher.PLANNER),
            hears=(*topics.SENSOR_TOPICS, topics.CLOCK),
            other=('planner/transition_event',),
        ),
        Enclave(node='bridge', publishes=published_by(*VEHICLE, Publisher.SIMULATION), hears=(topics.COMMAND,)),
        Enclave(node='carla_bridge', publishes=published_by(*VEHICLE), hears=(topics.COMMAND,)),
        # For a vehicle interface of your own.
        Enclave(node='vehicle', publishes=published_by(*VEHICLE), hears=(topics.COMMAND, topics.CLOCK)),
        Enclave(
            node='command_adapter',
            publishes=published_by(Publisher.COMMAND_RECEIVER),
            hears=(topics.COMMAND, topics.ODOMETRY, topics.CLOCK),
            other=tuple(adapter.topic.removeprefix('/') for adapter in ADAPTERS.values()),
        ),
        Enclave(node='recorder', hears=EVERYTHING),
        Enclave(node='player', publishes=published_by(Publisher.CLOCK_SOURCE, Publisher.VEHICLE)),
        Enclave(node='vehicle_probe', hears=EVERYTHING),
        Enclave(node='service_call', requests=(*called, 'planner/change_state', *set_by_operator)),
    )
    return tuple(_with(each, offers.get(each.node, ())) for each in found)


def _with(enclave: Enclave, offers: tuple[str, ...]) -> Enclave:
    """Adds what every node has."""
    return Enclave(
        node=enclave.node,
        publishes=(*enclave.publishes, *published_by(Publisher.ANY_NODE)),
        hears=enclave.hears,
        offers=(*offers, *NODE_SERVICES),
        requests=enclave.requests,
        other=(*enclave.other, *NODE_TOPICS),
    )


def enclave_path(node: str, namespace: str = '') -> str:
    """Path of a node's enclave in the keystore; namespace: '' or as '/car1', so that cars do not share keys."""
    return f'{namespace or ROOT}/{node}'


def policy(namespace: str = '') -> ElementTree.Element:
    """The policy of all enclaves in one document, for `ros2 security generate_artifacts -p`."""
    root = ElementTree.Element('policy', version=VERSION)
    listed = ElementTree.SubElement(root, 'enclaves')
    for each in enclaves():
        profiles = ElementTree.SubElement(
            ElementTree.SubElement(listed, 'enclave', path=enclave_path(each.node, namespace)), 'profiles'
        )
        profile = ElementTree.SubElement(profiles, 'profile', ns=namespace or '/', node=each.node)
        # Relative to the profile's namespace; the clock and the diagnostics of a namespaced graph are remapped there.
        published = [*(name.removeprefix('/') for name in each.publishes), *each.other]
        _allow(profile, 'topic', 'publish', published)
        _allow(profile, 'topic', 'subscribe', [name.removeprefix('/') for name in each.hears])
        _allow(profile, 'service', 'reply', [f'{each.node}/{name}' for name in each.offers])
        _allow(profile, 'service', 'request', list(each.requests))
    ElementTree.indent(root)
    return root


def _allow(profile: ElementTree.Element, kind: str, what: str, names: list[str]) -> None:
    if not names:
        return
    parent = ElementTree.SubElement(profile, f'{kind}s', {what: 'ALLOW'})
    for name in names:
        ElementTree.SubElement(parent, kind).text = name


def policy_text(namespace: str = '') -> str:
    """`policy` as an XML file."""
    body = ElementTree.tostring(policy(namespace), encoding='unicode')
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'


def policy_file(folder: Path, namespace: str = '') -> Path:
    """Where the policy of a namespace goes: 'raw2drive.policy.xml', 'car1.policy.xml'."""
    return folder / f'{(namespace or ROOT)[1:].replace("/", "_")}.policy.xml'
