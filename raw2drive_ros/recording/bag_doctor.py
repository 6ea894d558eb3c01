"""Checks whether a bag is fit for training and replay: what is missing, lost, late or out of order, worst first."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msg_adapters.factory import RosbagsFactory
from msg_adapters.stamps import stamp_ns
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.contracts.verdicts import Verdicts
from raw2drive_ros.driving.continuity import GAP_PERIODS
from raw2drive_ros.recording.bag_checks import metadata_against_storage
from raw2drive_ros.recording.bag_info import bag_info
from raw2drive_ros.recording.bag_reader import open_bag, read_calibrations
from raw2drive_ros.recording.clock_doctor import clock_complaints
from raw2drive_ros.recording.ticks import (
    EXTRAS,
    PRIVILEGED,
    TickCounts,
    checked,
    checked_messages,
    read_advice,
    read_ticks,
)

Severity = Literal['error', 'warning', 'note']
ORDER = ('error', 'warning', 'note')
# Gaps of more periods of a topic than this are reported. Between ticks, `continuity` says what is a gap.
SILENT_PERIODS = 3.5


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
    found = [*_missing(rows), *_extras(rows), *_rates(rows), *_ticks(path, rows)]
    found += [Complaint(*finding) for finding in clock_complaints(path)]
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


def _extras(rows: dict[str, dict]) -> list[Complaint]:
    """What the simulator of today publishes with every tick, and this bag lacks, or holds of some ticks only."""
    ticks = rows[topics.BEV]['messages'] if topics.BEV in rows else 0
    found = []
    if ticks and (absent := [name for name in EXTRAS if name not in rows]):
        text = f'no {", ".join(absent)}: of an older simulator, or driven without visibility'
        found.append(Complaint('note', text, 'collect anew for models that read them'))
    for name in EXTRAS:
        if ticks and name in rows and rows[name]['messages'] < ticks:
            text = f'{name}: {rows[name]["messages"]} messages for {ticks} of {topics.BEV}'
            found.append(Complaint('warning', text, 'models that read it do not use the other ticks'))
    return found


def _rates(rows: dict[str, dict]) -> list[Complaint]:
    found = []
    for name, row in rows.items():
        spec = topics.BY_NAME.get(name)
        if spec is None or not spec.rate_hz or row['messages'] < 3:
            continue
        if row['largest_gap_s'] > SILENT_PERIODS / spec.rate_hz:
            text = f'{name}: a gap of {row["largest_gap_s"]:.2f} s at {spec.rate_hz:g} Hz'
            found.append(Complaint('warning', text, 'was the recorder overloaded, or the sensor silent?'))
    return found


def _ticks(path: Path, rows: dict[str, dict]) -> list[Complaint]:
    """Problems that the readers of training and replay find, with their own verdicts and counts."""
    found = []
    cameras = [name for name in rows if name.startswith('/sensing/camera/') and '/image_raw' in name]
    held = set(PRIVILEGED) & set(rows)
    privileged, counts, factory = len(held) == len(PRIVILEGED), TickCounts(), RosbagsFactory()
    alone = set(EXTRAS) & set(rows) | (set() if privileged else held)
    try:
        with open_bag(path) as reader:
            read_advice(reader, factory, counts.verdicts)
            for topic, _, message in checked_messages(reader, factory, alone, counts.verdicts):
                checked(topic, message, counts.verdicts)
            calibrated = len(read_calibrations(reader, factory))
            for _ in read_ticks(reader, path, cameras=bool(cameras), privileged=privileged, counts=counts):
                pass
    except Exception as error:
        # Damaged files raise all kinds of errors.
        remedy = 'record again' if counts.verdicts.unusable() else f'raw2drive bag recover {path} --out NEW'
        found.append(Complaint('error', f'cannot be turned into ticks: {error}', remedy))
        calibrated = len(cameras)
    found += [
        Complaint('warning', line, 'left out, and its tick with it; docs/topics.md says what belongs there')
        for line in counts.verdicts.lines()
    ]
    found += _losses(counts)
    if cameras and calibrated < len({name.split('/')[3] for name in cameras}):
        found.append(Complaint('warning', 'not every camera has its calibration', 'record camera_info and extrinsics'))
    return [*found, *_out_of_order(path)]


def _losses(counts: TickCounts) -> list[Complaint]:
    """What of the drive is not in the ticks, and where sequences are cut for it."""
    said = [
        (
            counts.incomplete,
            f'{counts.incomplete} of {counts.ticks + counts.incomplete} ticks are incomplete',
            'a camera, IMU, odometry or privileged message of them is missing or refused',
        ),
        (
            counts.without_route,
            f'{counts.without_route} ticks have no route of their episode',
            f'was {topics.ROUTE} lost?',
        ),
        (counts.missing, f'{counts.missing} ticks are missing as a whole', 'was the recorder overloaded?'),
        (
            counts.cuts,
            f'{counts.cuts} gaps of more than {GAP_PERIODS:g} periods, or incomplete ticks: sequences are cut there',
            'training and driver begin anew behind each',
        ),
        (
            counts.begins_lost + counts.ends_lost,
            f'{counts.begins_lost} first and {counts.ends_lost} last or terminal ticks of episodes are lost',
            'training does not see these beginnings and ends',
        ),
        (counts.back, f'time goes back {counts.back} times', 'record drives into bags of their own'),
    ]
    return [Complaint('warning', text, remedy) for count, text, remedy in said if count]


def _out_of_order(path: Path) -> list[Complaint]:
    last: dict[str, int] = {}
    backwards: dict[str, int] = {}
    # What cannot be read as a whole is complained of elsewhere.
    with suppress(BagError), open_bag(path) as reader:
        # A foreign type has a complaint of its own.
        fit = {c.topic for c in reader.connections if c.msgtype == getattr(topics.BY_NAME.get(c.topic), 'msgtype', '')}
        messages = checked_messages(reader, RosbagsFactory(), {topics.IMU, topics.ODOMETRY} & fit, Verdicts())
        for topic, _, message in messages:
            stamp = stamp_ns(message.header.stamp)
            if stamp < last.get(topic, stamp):
                backwards[topic] = backwards.get(topic, 0) + 1
            last[topic] = stamp
    return [
        Complaint('warning', f'{topic}: {count} stamps go backwards', 'do several publishers share the topic?')
        for topic, count in backwards.items()
    ]
