"""What the bridge publishes of actors, signals and masks, and the recorder writes, is what the simulation knows."""

import numpy as np

from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.graph.drive import GraphJob, drive_graph
from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.recording.bag_doctor import examine
from raw2drive_ros.recording.bag_reader import open_bag
from raw2drive_ros.recording.ticks import EXTRAS, read_ticks
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId

ROUTE = RouteId('SignalizedJunctionLeftTurn', 1)
TICKS = 40


def test_a_recorded_drive_holds_the_privileged_frames_of_the_simulation_bit_for_bit(tmp_path) -> None:
    job = GraphJob(tmp_path, (ROUTE,), sim_driver='rule', max_ticks=TICKS)
    with reserve_domain(None) as domain:
        drive_graph(job, domain)
    expected = []
    env = DrivingEnv(SimulationConfig(cameras=False, end_on_infraction=False))
    drive_route(env, make_driver('rule'), ROUTE, lambda tick, _: expected.append(tick.privileged), max_ticks=TICKS)
    with open_bag(tmp_path / 'bag') as reader:
        found = [tick.privileged for tick in read_ticks(reader, tmp_path / 'bag', cameras=False, extras=EXTRAS)]
    assert len(found) >= TICKS and any(len(frame.actors) for frame in found)
    for frame, true in zip(found, expected, strict=False):
        assert frame.actors.tobytes() == true.actors.tobytes()
        assert np.array_equal(frame.signals, true.signals) and np.array_equal(frame.ego, true.ego)
        assert np.array_equal(frame.bev_visible, true.bev_visible) and np.array_equal(frame.bev, true.bev)
    assert not [complaint for complaint in examine(tmp_path / 'bag') if 'privileged' in complaint.text]
