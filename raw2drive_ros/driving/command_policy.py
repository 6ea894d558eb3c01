"""What a vehicle does while no command arrives: hold the last one briefly, then brake. It never waits indefinitely."""

from __future__ import annotations

from dataclasses import dataclass

from raw2drive_ros.contracts.public import Control


@dataclass(slots=True)
class CommandPolicy:
    """hold_s: how long a command stays valid, in simulated or vehicle time. brake: pedal [0, 1] after that."""

    hold_s: float
    brake: float
    last: Control | None = None
    last_ns: int = 0
    missed: int = 0

    def reset(self) -> None:
        self.last, self.last_ns = None, 0

    def accept(self, control: Control, stamp_ns: int) -> None:
        self.last, self.last_ns = control, stamp_ns

    def expired(self, stamp_ns: int) -> bool:
        """Whether the last command is too old to be held."""
        return stamp_ns - self.last_ns > round(self.hold_s * 1e9)

    def missing(self, stamp_ns: int) -> Control:
        """The command to apply at `stamp_ns` in place of the missing one."""
        self.missed += 1
        if self.last is not None and not self.expired(stamp_ns):
            return self.last
        last = self.last or Control()
        return Control(0.0, self.brake, last.steer, last.reverse)
