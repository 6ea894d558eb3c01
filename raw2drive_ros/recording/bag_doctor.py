"""Checks whether a bag is fit for training and replay: what is missing, lost, late or out of order, worst first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msg_adapters.factory import RosbagsFactory
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.recording.bag_checks import metadata_against_storage
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import decoded, messages_in, open_bag, read_calibrations, read_ticks

Severity = Literal['error', 'warning', 'note']
ORDER = ('error', 'warning', 'note')
# Gaps of more periods than this are reported.
GAP_PERIODS = 3.5


@dataclass(frozen=True, slots=True)
class Complaint:
    """One problem of a bag, and its remedy."""

    severity: Severity
    text: str
    remedy: str


def examine(path: Path) -> list[Complaint]:
    """Read the whole bag and decode everything that the readers of this package use. A bag that cannot be opened is a
    complaint too, not an exception."""
    try:
        info = bag_info(path)
    except BagError as error:
        return [Complaint('error', str(error), f'raw2drive bag recover {path} --out NEW')]
    rows = {row['topic']: row for row in info['topics']}
    found = [*_missing(rows), *_rates(rows), *_ticks(path, rows)]
    found += [Complaint('warning', text, 'raw2drive bag recover') for text in metadata_against_storage(path)]
    if not info['provenance']:
        found.append(Complaint('note', 'no provenance: who recorded it, with what?', 'record with raw2drive record'))
    foreign = sorted(set(rows) - set(topics.BY_NAME))
    if foreign:
        found.append(Complaint('note', f'topics that nothing here reads: {", ".join(foreign)}', 'raw2drive bag cut'))
    return sorted(found, key=lambda complaint: ORDER.index(complaint.severity))


def _missing(rows: dict[str, dict]) -> list[Complaint]:
    found = []
    for name in topics.SENSOR_TOPICS:
        spec = topics.BY_NAME[name]
        raw_or_compressed = {name, name.removesuffix('/compressed'), f'{name}/compressed'}
        if not raw_or_compressed & set(rows) and not spec.optional and spec.rate_hz > 0:
            found.append(Complaint('warning', f'{name} is missing', 'no planner can be replayed on it'))
    privileged = [s.name for s in topics.TOPICS if s.privileged and not s.optional and s.name not in rows]
    if privileged:
        found.append(Complaint('note', f'no {", ".join(privileged)}', 'stage 1 needs bags of the simulator'))
    for name, row in rows.items():
        spec = topics.BY_NAME.get(name)
        if spec is not None and spec.msgtype != row['type']:
            found.append(Complaint('error', f'{name} is {row["type"]}, not {spec.msgtype}', 'see docs/topics.md'))
    return found


def _rates(rows: dict[str, dict]) -> list[Complaint]:
    found = []
    for name, row in rows.items():
        spec = topics.BY_NAME.get(name)
        if spec is None or not spec.rate_hz or row['messages'] < 3:
            continue
        if row['largest_gap_s'] > GAP_PERIODS / spec.rate_hz:
            text = f'{name}: a gap of {row["largest_gap_s"]:.2f} s at {spec.rate_hz:g} Hz'
            found.append(Complaint('warning', text, 'was the recorder overloaded, or the sensor silent?'))
    return found


def _ticks(path: Path, rows: dict[str, dict]) -> list[Complaint]:
    """Problems that the readers of training and replay find."""
    found = []
    cameras = [name for name in rows if name.startswith('/sensing/camera/') and '/image_raw' in name]
    privileged = {topics.BEV, topics.EGO, topics.TRANSITION} <= set(rows)
    try:
        with open_bag(path) as reader:
            count = sum(1 for _ in read_ticks(reader, path, cameras=bool(cameras), privileged=privileged))
            calibrated = len(read_calibrations(reader, RosbagsFactory()))
    except Exception as error:
        return [Complaint('error', f'cannot be turned into ticks: {error}', f'raw2drive bag recover {path} --out NEW')]
    expected = max((rows[name]['messages'] for name in cameras), default=0)
    if expected > count:
        text = f'{expected - count} of {expected} ticks are incomplete'
        found.append(Complaint('warning', text, 'a camera, IMU or odometry message of them is missing'))
    if cameras and calibrated < len({name.split('/')[3] for name in cameras}):
        found.append(Complaint('warning', 'not every camera has its calibration', 'record camera_info and extrinsics'))
    found += _out_of_order(path)
    return found


def _out_of_order(path: Path) -> list[Complaint]:
    factory, last, backwards = RosbagsFactory(), {}, {}
    with open_bag(path) as reader:
        wanted = [c for c in reader.connections if c.topic in (topics.IMU, topics.ODOMETRY)]
        for connection, _, data in messages_in(reader, connections=wanted):
            stamp = stamp_ns(decoded(factory, reader, connection, data).header.stamp)
            if stamp < last.get(connection.topic, stamp):
                backwards[connection.topic] = backwards.get(connection.topic, 0) + 1
            last[connection.topic] = stamp
    return [
        Complaint('warning', f'{topic}: {count} stamps go backwards', 'do several publishers share the topic?')
        for topic, count in backwards.items()
    ]
