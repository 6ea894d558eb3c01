"""Which options of a verb mean something to the drivers that it was asked for."""

from __future__ import annotations

import argparse

from raw2drive_ros.cli.parser import refuse
from raw2drive_ros.evaluation.drivers import DRIVERS, driver_entry

# dest of the verb's option -> name in `DriverOptions`.
READ_AS = {'bundle': 'bundle', 'training_run': 'run', 'threads': 'threads', 'driver_args': 'arguments'}


def refuse_for_drivers(options: argparse.Namespace, *names: str) -> None:
    """Raises UnknownDriverError; UsageError for an option that none of these drivers reads."""
    entries = [driver_entry(name) for name in names]
    for dest, wanted in READ_AS.items():
        if not any(wanted in entry.reads for entry in entries):
            known = (
                ', '.join(name for name, entry in DRIVERS.items() if wanted in entry.reads) or 'package.module:Class'
            )
            refuse(options, [dest], f'is for {known}; driver {names[0]} does not read it')
    if not any(entry.cameras for entry in entries):
        refuse(options, ['blind'], f'driver {names[0]} does not look at the cameras anyway')
