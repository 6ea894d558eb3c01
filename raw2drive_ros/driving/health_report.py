"""Log lines about the sensors: one per change, not one per check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from raw2drive_ros.driving.sensor_monitor import Finding


class Line(NamedTuple):
    """alarming: to be logged as a warning; otherwise as information."""

    alarming: bool
    text: str


@dataclass(slots=True)
class HealthReport:
    """Remembers the findings that were reported last."""

    _said: list[str] | None = None

    def lines(self, findings: Sequence[Finding], *, complete: bool) -> list[Line]:
        """What changed since the last call: new causes with their remedies, or that all sensors are healthy.

        complete: every input was heard since the start; before that, no findings do not mean healthy sensors. While
        no input at all was heard, one line lists them: without a vehicle nothing is broken.
        """
        if not findings and not complete:
            return []
        subjects = [f'{finding.subject} {finding.unheard}' for finding in findings]
        if subjects == self._said:
            return []
        self._said = subjects
        if not findings:
            return [Line(alarming=False, text='nominal: all sensors are well')]
        broken = [finding for finding in findings if not finding.unheard]
        said = [Line(alarming=True, text=f'{f.health.name.lower()}: {f.cause}; {f.remedy}') for f in broken]
        waiting = [finding.subject for finding in findings if finding.unheard]
        if waiting:
            said.append(Line(alarming=False, text=f'waiting for {", ".join(waiting)}: nothing heard yet'))
        return said
