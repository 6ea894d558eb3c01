"""The vehicle's end of `/control/command`: obeys the one safety gate, and stops by itself for anybody else.

Bridges, the command adapter and the example vehicle all use this class; docs/vehicle_interface.md is the same contract
in words, for vehicles that are written in another language.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from msg_adapters.commands import ACTIVATION, decision_from_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ContractError
from raw2drive_ros.contracts.public import Control, Decision, VehicleStatus
from raw2drive_ros.driving.command_policy import CommandPolicy
from raw2drive_ros.driving.single_writer import SingleWriter

REMEDY = 'end the other publisher, let the car stand, then: raw2drive call /safety_gate/activate'


@dataclass(slots=True)
class CommandReceiver:
    """Checks every command and remembers a stop until the gate is activated again.

    key: of the signatures; None obeys unsigned commands, for a gate that has no key. policy: what to do while no
    command arrives. stopped: why the vehicle brakes by itself and obeys nothing, '' while it obeys. refused: messages
    that were no command. activation: the newest that was heard (see `Gate.activation`).

    The stop ends with the first valid command whose activation is newer: somebody has called `~/activate` of the gate.
    A gate that was started anew has no newer one, so a stop outlives the gate that knew of it.
    """

    policy: CommandPolicy
    key: bytes | None = None
    stopped: str = ''
    refused: int = 0
    activation: int = 0
    placed: int = 0
    ticks: int = 0
    writer: SingleWriter = field(init=False)

    def __post_init__(self) -> None:
        self.writer = SingleWriter(topics.COMMAND, self.key)

    def place(self) -> None:
        """A simulation has put the car somewhere else: neither command nor stop of the last drive applies any more."""
        self.policy.reset()
        self.stopped = ''
        self.writer.release()
        # Also newer than the count of a bridge before this one: milliseconds of the system clock.
        self.placed = max(self.placed + 1, time.time_ns() // 1_000_000)
        self.ticks = 0

    def receive(self, message: Any) -> Decision | None:
        """The command, or None for a message that is none; the car then has to stop (`stopped` says why)."""
        why = self.writer.check(message)
        if not why:
            try:
                decision = decision_from_message(message)
                decision.control.validate()
                activation = _activation(decision)
            except ContractError as error:
                why = str(error)
        if why:
            self.refused += 1
            self.stopped = self.stopped or f'a message on {topics.COMMAND} was refused: {why}'
            # Whoever is activated next may be another gate; until then nobody is obeyed.
            self.writer.release()
            return None
        if activation > self.activation:
            # Activated since the stop: by a person, and only on a standing car.
            self.activation, self.stopped = activation, ''
        return None if self.stopped else decision

    def brake(self) -> Control:
        """What the car does while it is stopped: the policy's brake; steering and gear stay as they are."""
        last = self.policy.last or Control()
        return Control(0.0, self.policy.brake, last.steer, last.reverse)

    def status(self, stamp_ns: int, speed_mps: float | None, sequence: int) -> VehicleStatus:
        """The report to the gate."""
        return VehicleStatus(
            stamp_ns, speed_mps, bool(self.stopped), self.activation, self.placed, self.ticks, sequence
        )


def _activation(decision: Decision) -> int:
    value = decision.info.get(ACTIVATION, 0.0)
    if value < 0 or value != int(value):
        raise ContractError(f'{ACTIVATION} is {value:g}')
    return int(value)
