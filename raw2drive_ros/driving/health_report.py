"""What a log says of the sensors: each change once, in words, and not the same cause at every look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from raw2drive_ros.driving.sensor_monitor import Finding


class Line(NamedTuple):
    """alarming: a warning; otherwise only information."""

    alarming: bool
    text: str


@dataclass(slots=True)
class HealthReport:
    """Remembers what was said."""

    _said: list[str] = field(default_factory=list)

    def lines(self, findings: Sequence[Finding]) -> list[Line]:
        """What is new since the last call: causes with their remedies, or that all is well again.

        Inputs that were never heard since the start are one line: before a vehicle is there, nothing is broken.
        """
        subjects = [f'{finding.subject} {finding.unheard}' for finding in findings]
        if subjects == self._said:
            return []
        self._said = subjects
        if not findings:
            return [Line(False, 'nominal: all sensors are well')]
        said = [Line(True, f'{f.health.name.lower()}: {f.cause}; {f.remedy}') for f in findings if not f.unheard]
        waiting = [finding for finding in findings if finding.unheard]
        if waiting:
            missing = ', '.join(finding.subject for finding in waiting)
            said.append(Line(bool(said), f'waiting for {missing}: nothing heard yet'))
        return said
