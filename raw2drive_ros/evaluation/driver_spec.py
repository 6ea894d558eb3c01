"""A driver as name, weights and options, which is sent to worker processes; each builds the driver from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from raw2drive_ros.evaluation.drivers import SIGHTLESS, make_driver
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

    def build(self) -> EpisodeDriver:
        driver = make_driver(self.name, self.bundle, self.run, 0.0, self.threads)
        if self.table:
            driver = through_table(self.name, driver)
        return BlindfoldedDriver(driver) if self.blind else driver

    def identity(self) -> str:
        """Text that identifies the driver in results: its name, a hash of its weights (not their path), its options."""
        # Late imports: only drivers with weights need torch.
        weights = ''
        if self.name == 'raw' and self.bundle is not None:
            from raw2drive_ros.driving.bundle import load_bundle

            weights = load_bundle(self.bundle).identity
        elif self.name == 'privileged':
            from raw2drive_ros.world_model.teacher import teacher_identity

            weights = teacher_identity(self.run or default_teacher())
        elif self.name in SIGHTLESS:
            from raw2drive_ros.evaluation.cheats import tuned_identity

            weights = tuned_identity()
        options = ['blind'] * self.blind + ['table'] * self.table
        return ' '.join(filter(None, (self.name, weights, *options)))
