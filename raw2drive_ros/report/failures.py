"""Failed drives for the report: what happened, what it looked like, and the command that repeats the drive."""

from __future__ import annotations

import base64
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from raw2drive_ros.evaluation.results import Results, filmstrip_path, filmstrips_of, id_of
from raw2drive_ros.simulation.route_id import RouteId


@dataclass(frozen=True, slots=True)
class Failure:
    """picture: the filmstrip as base64 JPEG, or ''. note: why there is none."""

    row: dict[str, Any]
    command: str
    picture: str
    note: str


def replay_command(driver: str, route: RouteId) -> str:
    """Shell command that shows the drive again. driver: identity text of the results, see `DriverSpec.identity`.

    Identities hold a hash of the weights and not their path, so that the command drives the shipped weights; for others
    --bundle or --run has to be added.
    """
    name, *rest = driver.split() or ['']
    blind = ['--blind'] if 'blind' in rest else []
    command = ['raw2drive', 'scenario', 'show', route.type, '--seed', str(route.seed), '--weather', route.weather]
    command += ['--repetition', str(route.repetition), '--driver', name, *blind, '--video', 'out.mp4']
    return shlex.join(command)


def failures_of(results_file: Path, results: Results, max_filmstrips: int) -> list[Failure]:
    """Worst first; at most `max_filmstrips` of them with a picture."""
    found: list[Failure] = []
    shown = 0
    for row in sorted((r for r in results.rows if not r['success']), key=lambda r: r['driving_score']):
        path = filmstrip_path(filmstrips_of(results_file), row['id'])
        picture, note = '', ''
        if not path.is_file():
            note = 'no picture was recorded'
        elif shown >= max_filmstrips:
            note = f'picture left out of the page: {path.parent.name}/{path.name}'
        else:
            picture = base64.b64encode(path.read_bytes()).decode()
            shown += 1
        found.append(Failure(row, replay_command(results.driver, id_of(row)), picture, note))
    return found
