"""How much of each topic is missing around places where a recording is damaged, in seconds."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field

# A topic with fewer messages has no period that could be told from them.
MIN_MESSAGES = 4
# Up to so many periods between two messages nothing is missing.
TOLERANCE = 1.5


@dataclass(slots=True)
class _Topic:
    """last_ns: stamp of the newest message. gaps_ns: between neighbours with nothing lost in between. across_ns: those
    with a damaged place in between."""

    last_ns: int
    place: int
    count: int = 0
    gaps_ns: list[int] = field(default_factory=list)
    across_ns: list[int] = field(default_factory=list)


class Losses:
    """Fed with messages and damaged places in the order in which they were recorded."""

    def __init__(self) -> None:
        self.place = 0
        self.end_ns = 0
        self.topics: dict[str, _Topic] = {}

    def damaged(self, end_ns: int = 0) -> None:
        """Something is missing here; end_ns: what is missing lasted until then, 0 where that is not known."""
        self.place += 1
        # A damaged head may claim any time; one far beyond everything else claims nothing.
        newest = max((topic.last_ns for topic in self.topics.values()), default=end_ns)
        if end_ns < newest + 3600 * 10**9:
            self.end_ns = max(self.end_ns, end_ns)

    def message(self, topic: str, stamp_ns: int) -> None:
        """A message that was saved."""
        known = self.topics.get(topic)
        if known is None:
            self.topics[topic] = _Topic(stamp_ns, self.place, 1)
            return
        gap_ns = stamp_ns - known.last_ns
        if gap_ns > 0:
            (known.gaps_ns if known.place == self.place else known.across_ns).append(gap_ns)
        known.last_ns, known.place = max(stamp_ns, known.last_ns), self.place
        known.count += 1

    def seconds(self) -> dict[str, float]:
        """topic -> seconds without messages, beyond its usual period, across damaged places; only what is above zero.

        Topics that are sent on change only, and those of which hardly a message was saved, have no period and are left
        out.
        """
        end_ns = max([self.end_ns, *(topic.last_ns for topic in self.topics.values())])
        found = {}
        for name, topic in self.topics.items():
            if topic.count < MIN_MESSAGES or not topic.gaps_ns:
                continue
            period_ns = statistics.median(topic.gaps_ns)
            across = [*topic.across_ns, *([end_ns - topic.last_ns] if topic.place != self.place else [])]
            lost_ns = sum(gap - period_ns for gap in across if gap > TOLERANCE * period_ns)
            if lost_ns > 0:
                found[name] = lost_ns * 1e-9
        return found
