"""The whole graph in lock-step: ticks per second, planner latency and messages lost, at two image sizes.

For 224x400 the planner runs an untrained nano model, because the shipped one takes 96x160; the graph, its transport
and its recorder are the real ones.

python -m benchmarks.graph [--ticks 300]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from raw2drive_ros.contracts.actions import ACTION_COUNT
from raw2drive_ros.driving.bundle import save_bundle
from raw2drive_ros.graph.drive import GraphJob, drive_graph
from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.settings import default_bundle
from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.tables.vector_layout import VECTOR_SIZE
from raw2drive_ros.training.config import make_config
from raw2drive_ros.world_model.actor_critic import Actor
from raw2drive_ros.world_model.streams import RawWorldModel


def untrained_bundle(folder: Path, size: tuple[int, int]) -> Path:
    """A nano policy with random weights for images of size (H, W)."""
    config = make_config('nano').model.model_copy(update={'image_size': size})
    rig = camera_rig(*size)
    model = RawWorldModel(config, rig, VECTOR_SIZE, config.ego_size, ACTION_COUNT)
    save_bundle(folder / 'bundle', config, rig, model, Actor(config, ACTION_COUNT), {'untrained': True})
    return folder / 'bundle'


def main() -> None:
    """Drive one route per case; print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--ticks', type=int, default=300)
    options = parser.parse_args()
    print('| images | planner | ticks/s | tick p50 ms | tick p99 ms | planner p50 ms | planner p99 ms | lost |')
    print('|---|---|---|---|---|---|---|---|')
    for size, shipped in (((96, 160), True), ((96, 160), False), ((224, 400), False)):
        with tempfile.TemporaryDirectory(prefix='raw2drive_bench_') as name:
            folder = Path(name)
            bundle = default_bundle() if shipped else untrained_bundle(folder, size)
            job = GraphJob(
                folder / 'out', (RouteId('HardBreakRoute', 1),), bundle, image_size=size, max_ticks=options.ticks
            )
            job.out.mkdir()
            with reserve_domain(None) as domain:
                timing = drive_graph(job, domain)[1]
            planner = timing['planner_ms']
            print(
                f'| {size[0]}x{size[1]} | {"laptop, shipped" if shipped else "nano, untrained"} '
                f'| {timing["ticks_per_s"]} | {timing["tick_ms"]["p50"]:.1f} | {timing["tick_ms"]["p99"]:.1f} '
                f'| {planner["p50"]:.1f} | {planner["p99"]:.1f} | {timing["messages_lost"]} |'
            )


if __name__ == '__main__':
    main()
