"""What became of the messages of each topic: planner, bag reader, doctor and trainer all count with this."""

from __future__ import annotations

from dataclasses import dataclass, field

# Of the messages of a topic. One message may be damaged in any recording; a publisher that breaks its contract again
# and again makes the rest of what it says doubtful too. A single refused message never makes a bag unusable.
LARGEST_REFUSED_SHARE = 0.05


@dataclass(slots=True)
class Verdicts:
    """accepted, refused: messages by topic. first: the first refused one of each topic: its stamp and the reason."""

    accepted: dict[str, int] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)
    first: dict[str, str] = field(default_factory=dict)

    def accept(self, topic: str) -> None:
        self.accepted[topic] = self.accepted.get(topic, 0) + 1

    def refuse(self, topic: str, stamp_ns: int, why: str) -> None:
        self.refused[topic] = self.refused.get(topic, 0) + 1
        self.first.setdefault(topic, f'at {stamp_ns} ns: {why}')

    def lines(self) -> list[str]:
        """A sentence for each topic of which messages were refused."""
        return [
            f'{topic}: {count} of {self.seen(topic)} messages refused; the first {self.first[topic]}'
            for topic, count in sorted(self.refused.items())
        ]

    def seen(self, topic: str) -> int:
        """Messages of the topic, refused or not."""
        return self.refused.get(topic, 0) + self.accepted.get(topic, 0)

    def unusable(self) -> str:
        """Why a recording with these messages cannot be used: the sentence of a topic with more than one refused
        message and more than `LARGEST_REFUSED_SHARE`; empty where there is none."""
        for topic, line in zip(sorted(self.refused), self.lines(), strict=True):
            if self.refused[topic] > max(1.0, LARGEST_REFUSED_SHARE * self.seen(topic)):
                return f'{line}; more than {LARGEST_REFUSED_SHARE:.0%} make a bag unusable'
        return ''
