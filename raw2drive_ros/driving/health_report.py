"""What a log says of the sensors: each change once, in words, and not the same cause at every look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from raw2drive_ros.driving.sensor_monitor import Finding


class Line(NamedTuple):
    """alarming: a warning; otherwise only information."""

    alarming: bool
    text: str


@dataclass(slots=True)
class HealthReport:
    """Remembers what was said."""

    _said: list[str] | None = None

    def lines(self, findings: Sequence[Finding], *, complete: bool) -> list[Line]:
        """What is new since the last call: causes with their remedies, or that all is well again.

        complete: every input was heard since the start; before that, silence is no sign of health. Before anybody is
        heard, all inputs are one line: nothing is broken while no vehicle is there.
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
