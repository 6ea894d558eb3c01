"""How well, how fast and how cheaply the honest expert drives, per type: success, time against the oracle, ticks per second.

python -m benchmarks.expert [--suite b2d220] [--seeds 0,1] [--types A,B] [--oracle oracle.jsonl]

The oracle is slow: its rows are read from the file of `raw2drive evaluate --driver oracle --out oracle.jsonl` where it
exists; without one, times are not compared. One process; times are CPU times of the whole drive, simulation included.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.suites import load_suite
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.tables.rates import DECISION_HZ


@dataclass
class Row:
    """Sums over the drives of one type."""

    drives: int = 0
    solved: int = 0
    ticks: int = 0
    cpu_s: float = 0.0
    shares: list[float] = field(default_factory=list)
    comfort: list[float] = field(default_factory=list)

    def add(self, other: Row) -> None:
        """Add another row's sums."""
        self.drives += other.drives
        self.solved += other.solved
        self.ticks += other.ticks
        self.cpu_s += other.cpu_s
        self.shares += other.shares
        self.comfort += other.comfort

    def text(self, name: str) -> str:
        """One line of the table."""
        share = f'{np.mean(self.shares):8.2f}' if self.shares else '       -'
        comfort = f'{np.mean(self.comfort):7.1f}' if self.comfort else '      -'
        rate = self.ticks / max(self.cpu_s, 1e-9)
        return f'{name:44s} {self.solved:3d}/{self.drives:<3d} {share} {comfort} {rate:8.1f} {rate / DECISION_HZ:6.1f}x'


def oracle_seconds(path: Path | None) -> dict[str, float]:
    """Route -> seconds of the oracle, where it succeeded."""
    if path is None:
        return {}
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return {row['id']: row['duration_s'] for row in rows if row.get('success')}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--suite', default='b2d220')
    parser.add_argument('--seeds', default='')
    parser.add_argument('--types', default='')
    parser.add_argument('--driver', default='expert')
    parser.add_argument('--oracle', type=Path)
    options = parser.parse_args()
    reference = oracle_seconds(options.oracle)
    seeds = {int(seed) for seed in options.seeds.split(',') if seed}
    types = {name for name in options.types.split(',') if name}
    env = DrivingEnv(SimulationConfig(cameras=False, bev=False, end_on_infraction=False))
    table: dict[str, Row] = {}
    for route in load_suite(options.suite).routes:
        if (seeds and route.seed not in seeds) or (types and route.type not in types):
            continue
        started = time.process_time()
        drive = drive_route(env, make_driver(options.driver), route)
        spent, result = time.process_time() - started, drive.result
        row = Row(1, int(result.success), len(drive.controls), spent)
        if result.comfort is not None:
            row.comfort.append(result.comfort)
        if result.success and str(route) in reference:
            row.shares.append(result.duration_s / reference[str(route)])
        if not result.success:
            print(f'{route}: {result.infractions}', flush=True)
        table.setdefault(route.type, Row()).add(row)
    print(f'{"type":44s} solved  t/oracle comfort  ticks/s   real time')
    total = Row()
    for name, row in table.items():
        print(row.text(name))
        total.add(row)
    print(total.text('all'))


if __name__ == '__main__':
    main()
