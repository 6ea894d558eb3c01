"""Drivers that are classes of users: what they see, what they cannot reach, what is said when they are wrong."""

import json
import sys
import textwrap

import numpy as np
import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.actions import ACTIONS
from raw2drive_ros.contracts.errors import DriverClassError, DriverFailedError
from raw2drive_ros.evaluation.driver_spec import DriverSpec
from raw2drive_ros.evaluation.drivers import make_driver
from raw2drive_ros.evaluation.episode import drive_route
from raw2drive_ros.evaluation.evaluate import Conditions, RouteRunner
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig
from raw2drive_ros.simulation.route_id import RouteId

ROUTE = RouteId('LaneFollowing', 0)
PLAIN = SimulationConfig(cameras=False, bev=False, end_on_infraction=False)


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write a module into the working directory; returns the name of its class `Mine`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'path', list(sys.path))

    def writing(source: str, module: str = 'mine') -> str:
        (tmp_path / f'{module}.py').write_text(textwrap.dedent(source))
        monkeypatch.delitem(sys.modules, module, raising=False)
        return f'{module}:Mine'

    return writing


def body(drive: str, sensors: str = '()') -> str:
    return f'class Mine:\n    sensors = {sensors}\n    def drive(self, sensors):\n        {drive}\n'


def driven(name: str, ticks: int = 3, arguments: tuple[str, ...] = (), config: SimulationConfig = PLAIN):
    return drive_route(DrivingEnv(config), make_driver(name, arguments=arguments), ROUTE, max_ticks=ticks)


def test_it_drives_as_the_same_driver_in_process(write) -> None:
    name = write(body('return 0.3, 0.0, 0.0'))
    assert driven(name, 40).controls == driven('straight', 40).controls


@pytest.mark.parametrize(
    ('answer', 'control'),
    [
        ('return 4', ACTIONS[4]),
        ('import numpy; return numpy.int64(0)', ACTIONS[0]),
        ('import numpy; return numpy.array([0.5, 0, -0.1])', (0.5, 0.0, -0.1)),
        ('from raw2drive_ros.contracts.public import Control; return Control(0.2, 0.0, 0.1)', (0.2, 0.0, 0.1)),
    ],
)
def test_it_may_return_any_of_three_forms(write, answer, control) -> None:
    wanted = control if isinstance(control, tuple) else (control.throttle, control.brake, control.steer)
    env, driver = DrivingEnv(PLAIN), make_driver(write(body(answer)))
    driver.reset(0)
    tick, _ = env.reset_to(ROUTE)
    found = driver.control(env, tick.sensors, tick).control
    assert (found.throttle, found.brake, found.steer) == pytest.approx(wanted, abs=0.0)


def test_it_sees_the_sensors_bit_for_bit(write, tmp_path) -> None:
    name = write(
        """
        import numpy as np
        class Mine:
            sensors = ('cameras', 'imu', 'odometry', 'route')
            def __init__(self, out):
                self.out = out
            def drive(self, s):
                c = s.calibration['back']
                np.savez(self.out, *s.images.values(), names=list(s.images), k=c.intrinsics, pose=c.base_from_camera,
                         imu=[i.specific_force_mps2 for i in s.imu_samples], time_s=s.time_s,
                         odometry=(s.odometry.x_m, s.odometry.y_m, s.odometry.yaw_rad, s.odometry.speed_mps),
                         route=s.route.checkpoints_m)
                s.images['front'][:] = 0
                s.route.checkpoints_m[:] = 0
                return 6
        """
    )
    env = DrivingEnv(SimulationConfig((48, 80), bev=False))
    driver = make_driver(name, arguments=(f'out={tmp_path}/seen.npz',))
    driver.reset(0)
    tick, _ = env.reset_to(ROUTE)
    for _ in range(3):
        driver.control(env, tick.sensors, tick)
        seen = np.load(tmp_path / 'seen.npz')
        images = tick.sensors.images
        assert list(seen['names']) == list(images)
        assert all(np.array_equal(seen[f'arr_{i}'], image) for i, image in enumerate(images.values()))
        assert max(image.std() for image in images.values()) > 10.0
        back = next(camera for camera in env.rig if camera.name == 'back')
        assert np.array_equal(seen['k'], back.intrinsics) and np.array_equal(seen['pose'], back.base_from_camera)
        assert np.array_equal(seen['imu'], [sample.specific_force_mps2 for sample in tick.imu_samples])
        o = tick.sensors.odometry
        assert np.array_equal(seen['odometry'], (o.x_m, o.y_m, o.yaw_rad, o.speed_mps))
        last_time = float(seen['time_s'])
        assert np.abs(tick.route.checkpoints_m).max() > 0.0
        tick, *_ = env.step(ACTIONS[6])
    assert last_time == pytest.approx(0.2)


SPY = """
import gc, sys
class Mine:
    sensors = ('cameras', 'imu', 'odometry', 'route')
    def drive(self, sensors):
        found = {m for m in sys.modules if m.startswith(('raw2drive_ros.simulation', 'raw2drive_ros.evaluation',
                                                         'raw2drive_ros.contracts.privileged', 'highway_env'))}
        found |= {type(o).__name__ for o in gc.get_objects()} & {'World', 'DrivingEnv', 'EgoVehicle', 'RouteId', 'Tick'}
        frame = sys._getframe()
        while frame:
            found |= {n for n in frame.f_locals if n in ('env', 'world', 'tick', 'route_id')}
            frame = frame.f_back
        for module in ('raw2drive_ros.simulation.world', 'raw2drive_ros.evaluation.suites', 'raw2drive_ros.gym.env'):
            try:
                __import__(module)
                found.add(module)
            except ImportError:
                pass
        for name in ('world', 'privileged'):
            if hasattr(sensors, name):
                found.add(name)
        if found:
            raise RuntimeError(sorted(found))
        return 0
"""


def test_nothing_of_the_simulator_can_be_reached(write) -> None:
    """The spy looks through its modules, the garbage collector, the stack and what it is given; on a route where it
    finds nothing it brakes."""
    drive = driven(write(SPY), 2, config=SimulationConfig((48, 80), bev=False))
    assert [control.brake for control in drive.controls] == [1.0, 1.0]
    with pytest.raises(DriverFailedError, match=r'world'):
        driven(write(SPY.replace("'route')", "'route', 'privileged')"), 'allowed'), 2)


def test_the_seed_does_not_tell_the_route(write, tmp_path) -> None:
    source = body('return 0') + '    def reset(self, seed):\n        open("seeds", "a").write(f"{seed}\\n")\n'
    driver = make_driver(write(source))
    for seed in (3, 3, 4):
        driver.reset(seed)
    first, again, other = map(int, (tmp_path / 'seeds').read_text().split())
    assert first == again != other
    assert {first, other}.isdisjoint({3, 4})


def test_what_is_not_declared_is_named_when_it_is_used(write) -> None:
    with pytest.raises(
        DriverFailedError, match=r"sensors\.imu is not there: declare 'imu' in `sensors` \(mine\.py, line 4\)"
    ):
        driven(write(body('return sensors.imu', "('odometry',)")))
    with pytest.raises(DriverFailedError, match=r'sensors\.odometri is not there; did you mean odometry\?'):
        driven(write(body('return sensors.odometri', "('odometry',)")))


@pytest.mark.parametrize(
    ('answer', 'said'),
    [
        ('pass', 'drive returned NoneType, not a Control, an index of the action table, or'),
        ('return 39', 'drive returned action 39, which is not in the table of 39'),
        ('return -1', 'drive returned action -1'),
        ('return True', 'drive returned bool'),
        ('return 0.1, 0.2', r'drive returned \[0.1, 0.2\], not three finite numbers'),
        ('return 0.1, float("nan"), 0', 'not three finite numbers'),
        ('return 1.5, 0, 0', r'drive returned no command: Control.throttle 1.5 outside \[0, 1\]'),
        ('return "fast"', 'drive returned str'),
        ('from raw2drive_ros.contracts.public import Control; return Control("a")', 'drive returned no command'),
        ('return 1 / 0', r'ZeroDivisionError: division by zero \(mine.py, line 4\)'),
        ('import os; os._exit(3)', 'its process ended with exit code 3'),
    ],
)
def test_a_wrong_answer_fails_the_drive_with_one_line(write, capfd, answer, said) -> None:
    runner = RouteRunner(make_driver(write(body(answer))), Conditions())
    row, _ = runner.drive(ROUTE)
    with pytest.raises(DriverFailedError, match=said):
        driven(runner.driver.process.name)
    assert row.driving_score == 0.0
    (line,) = capfd.readouterr().err.splitlines()
    assert row.failure == f'error: {line.removeprefix("LaneFollowing/0: ")}'


def test_after_its_process_has_ended_it_drives_the_next_route(write) -> None:
    name = write(
        """
        import os, pathlib
        class Mine:
            sensors = ()
            def drive(self, sensors):
                if not pathlib.Path('was_here').exists():
                    pathlib.Path('was_here').touch()
                    os._exit(1)
                return 0
        """
    )
    driver, env = make_driver(name), DrivingEnv(PLAIN)
    with pytest.raises(DriverFailedError, match='ended with exit code 1'):
        drive_route(env, driver, ROUTE, max_ticks=2)
    assert len(drive_route(env, driver, ROUTE, max_ticks=2).controls) == 2


@pytest.mark.parametrize(
    ('name', 'source', 'arguments', 'said'),
    [
        ('absent.thing:Mine', '', (), 'no module absent in the working directory or on PYTHONPATH'),
        ('mine:Mime', body('return 0'), (), 'module mine has no class Mime; did you mean Mine?'),
        ('mine:', body('return 0'), (), 'is not of the form package.module:Class'),
        ('mine:Mine', 'class Mine:\n    pass\n', (), 'declares no sensors'),
        ('mine:Mine', body('return 0', "('camera',)"), (), "unknown sensor 'camera'; did you mean cameras?"),
        ('mine:Mine', body('return 0', "('imu')"), (), 'declares no sensors'),
        ('mine:Mine', 'class Mine:\n    sensors = ()\n', (), 'has no method drive(self, sensors)'),
        ('mine:Mine', 'class Mine:\n    sensors = ()\n    def drive(self): ...\n', (), 'write drive(self, sensors)'),
        ('mine:Mine', body('return 0') + '    def reset(self): ...\n', (), 'write reset(self, seed)'),
        ('mine:Mine', body('return 0'), ('gain=1',), "unexpected keyword argument 'gain'; it takes nothing"),
        ('mine:Mine', body('return 0'), ('gain',), '--driver-args gain: write key=value'),
        ('mine:Mine', body('return 0'), ('a=1', 'a=2'), 'a is given twice'),
        ('mine:Mine', 'import mathh\n', (), "ModuleNotFoundError: No module named 'mathh' (mine.py, line 1)"),
        ('mine:Mine', 'class Mine:\n  sensors = (\n', (), "SyntaxError: '(' was never closed"),
        ('mine:Mine', body('return 0') + '    def __init__(self): 1/0\n', (), 'division by zero (mine.py, line 5)'),
        ('mine:Mine', 'import raw2drive_ros.simulation\n', (), 'is privileged and cannot be imported by the planner'),
        ('mine:Mine', 'import os\nos._exit(7)\n', (), 'its process ended with exit code 7'),
    ],
)
def test_a_class_that_cannot_drive_is_refused_with_one_line(write, capfd, name, source, arguments, said) -> None:
    write(source)
    with pytest.raises(DriverClassError) as raised:
        make_driver(name, arguments=arguments)
    assert said in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1


def test_privileged_is_declared_and_shows_in_the_results(write, capsys, tmp_path) -> None:
    name = write(
        """
        class Mine:
            sensors = ('privileged', 'odometry')
            def drive(self, sensors):
                assert type(sensors.world).__name__ == 'World' and sensors.privileged.bev.any()
                return 0 if sensors.odometry.speed_mps > 3 else 13
        """
    )
    command = [
        'evaluate',
        '--driver',
        name,
        '--routes',
        'lane-following',
        '--seeds',
        '1',
        '--json',
        '--out',
        'out.jsonl',
    ]
    assert main(command) == 0
    assert json.loads(capsys.readouterr().out)['driver'] == 'mine:Mine (privileged)'
    header = json.loads((tmp_path / 'out.jsonl').read_text().splitlines()[0])
    assert header['driver'].startswith('mine:Mine (privileged) ')
    assert header['driver'].endswith(' sensors=odometry+privileged')


def test_identity_holds_hashes_of_source_and_weights_and_no_path(write, tmp_path) -> None:
    source = body('return 0') + '    def __init__(self, weights="", gain=1.0): ...\n'
    (tmp_path / 'net.npz').write_bytes(b'one')
    spec = DriverSpec(write(source), arguments=(f'weights={tmp_path}/net.npz', 'gain=0.5'))
    before = spec.identity()
    assert str(tmp_path) not in before and 'gain=0.5' in before and 'weights=sha256:' in before
    assert before.endswith('sensors=none')
    (tmp_path / 'net.npz').write_bytes(b'two')
    assert spec.identity() != before
    assert DriverSpec(write(source + '# changed\n', 'other')).identity().split()[1] != before.split()[1]


def test_the_command_line_names_what_is_wrong_in_one_line(write, capsys) -> None:
    name = write(body('return 0'))
    for command, said in (
        (['--driver', 'absent:Mine'], 'no module absent'),
        (['--driver', name, '--graph'], 'is a class, which drives in process only'),
        (['--driver', name, '--bundle', 'x'], 'does not read it'),
        (['--driver', 'rule', '--driver-args', 'a=1'], 'is for package.module:Class'),
    ):
        assert main(['evaluate', *command]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith('error: ') and said in line


def test_the_example_of_the_documents_drives() -> None:
    env = DrivingEnv(PLAIN)
    driver = make_driver('examples.drivers.pure_pursuit:PurePursuit', arguments=('speed_mps=6',))
    result = drive_route(env, driver, ROUTE).result
    assert result.route_completion == 100.0
