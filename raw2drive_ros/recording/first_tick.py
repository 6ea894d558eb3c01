"""Does a bag begin with the first tick of an episode, or in the middle of one? Written into its provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import transition_from_message
from raw2drive_ros.contracts import topics

# What a tick of training consists of besides its transition.
PARTS = frozenset(
    {topics.IMU, topics.ODOMETRY, *topics.published_by(topics.Publisher.SIMULATION)} - {topics.TRANSITION}
    | {name(camera) for camera in topics.CAMERAS for name in (topics.image_topic, topics.compressed_topic)}
)


@dataclass(slots=True)
class FirstTick:
    """expected: a bag that begins late is worth a warning (not one that is split by time or size)."""

    expected: bool = True
    stamp_ns: int | None = None
    episode: str = ''
    late: bool = False
    whole: bool = False
    _warned: bool = False

    @property
    def text(self) -> str:
        """For the provenance."""
        return f'{"with the first tick" if self.whole else "in the middle"} of {self.episode}'

    def hear(self, factory: RosbagsFactory, data: bytes) -> bool:
        """Take a transition's CDR bytes; True for the first one of the bag."""
        if self.stamp_ns is not None:
            return False
        try:
            message = factory.deserialize(data, topics.BY_NAME[topics.TRANSITION].msgtype)
            step, self.episode = transition_from_message(message)
        except Exception:
            # A recorder writes down what comes; damage may raise any error, and readers will name it.
            return False
        self.stamp_ns, self.late = step.stamp_ns, not step.is_first
        return True

    def judge(self, begins_ns: Mapping[str, int]) -> bool:
        """Judge at the end of a bag, from the first stamp of each topic in it; False where it holds no transition."""
        if self.stamp_ns is None:
            return False
        stamp_ns = self.stamp_ns
        self.whole = not self.late and all(first <= stamp_ns for name, first in begins_ns.items() if name in PARTS)
        return True

    def take_warning(self) -> str:
        """What to tell the user, once; '' when there is nothing."""
        if self.whole or self._warned or not self.expected:
            return ''
        self._warned = True
        return f'the recording begins {self.text}: its first tick is not there as a whole'
