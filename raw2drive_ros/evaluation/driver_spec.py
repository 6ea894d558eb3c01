"""A driver as name, weights and options, which is sent to worker processes; each builds the driver from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from raw2drive_ros.evaluation.drivers import CLASS_MARK, SIGHTLESS, make_driver
from raw2drive_ros.evaluation.episode_driver import BlindfoldedDriver, EpisodeDriver
from raw2drive_ros.evaluation.table_actions import through_table
from raw2drive_ros.settings import default_teacher


@dataclass(frozen=True, slots=True)
class DriverSpec:
    """What a worker process builds its driver from; see `drivers.make_driver` and, for table, `through_table`."""

    name: str
    bundle: Path | None = None
    run: Path | None = None
    threads: int = 1
    blind: bool = False
    table: bool = False
    arguments: tuple[str, ...] = ()

    def build(self) -> EpisodeDriver:
        driver = make_driver(self.name, self.bundle, self.run, 0.0, self.threads, self.arguments)
        if self.table:
            driver = through_table(self.name, driver)
        return BlindfoldedDriver(driver) if self.blind else driver

    @property
    def label(self) -> str:
        """The name for people; of a class it says whether it is privileged. Raises DriverClassError."""
        if CLASS_MARK not in self.name:
            return self.name
        from raw2drive_ros.evaluation.custom_driver import custom_label

        return custom_label(self.name)

    def identity(self) -> str:
        """Text that identifies the driver in results: its name, a hash of its weights (not their path), its options."""
        # Late imports: only drivers with weights need torch.
        name, weights = self.name, ''
        if CLASS_MARK in self.name:
            from raw2drive_ros.evaluation.custom_driver import custom_identity

            name = custom_identity(self.name, self.arguments)
        elif self.name == 'raw' and self.bundle is not None:
            from raw2drive_ros.driving.bundle import load_bundle

            weights = load_bundle(self.bundle).identity
        elif self.name == 'privileged':
            from raw2drive_ros.world_model.teacher import teacher_identity

            weights = teacher_identity(self.run or default_teacher())
        elif self.name in SIGHTLESS:
            from raw2drive_ros.evaluation.cheats import tuned_identity

            weights = tuned_identity()
        options = ['blind'] * self.blind + ['table'] * self.table
        return ' '.join(filter(None, (name, weights, *options)))
