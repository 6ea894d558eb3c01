"""Small real things that many tests share: bags, a nano teacher, a nano raw policy."""

import os

os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

from pathlib import Path

import cv2
import pytest
import torch

from raw2drive_ros.evaluation.collect import CollectConfig, collect
from raw2drive_ros.evaluation.world_drivers import rule_driver
from raw2drive_ros.runtime_folder import runtime_folder
from raw2drive_ros.training.export import export_bundle
from raw2drive_ros.training.run import train

torch.set_num_threads(1)
cv2.setNumThreads(1)

# What runs ROS graphs: process by process, alone on the machine, because nodes in real time share it with nobody.
GRAPH_TESTS = ('test/nodes/', 'test/carla_vehicle/test_bridge.py', 'test/evaluation/test_soak.py')
ROOT = Path(__file__).resolve().parents[1]


def pytest_collection_modifyitems(items) -> None:
    for item in items:
        if item.path.relative_to(ROOT).as_posix().startswith(GRAPH_TESTS):
            item.add_marker('graph')


@pytest.fixture(autouse=True)
def _no_latch_of_another_test(request) -> None:
    """A gate that a test leaves stopped must not hold the next test's car: they share ROS domains."""
    if request.node.get_closest_marker('graph'):
        for latch in runtime_folder().glob('latch_*'):
            latch.unlink(missing_ok=True)


NANO = {'threads': 1, 'log_every': 5, 'picture_every': 100, 'checkpoint_every': 5}


@pytest.fixture(scope='session')
def workspace(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp('raw2drive')


@pytest.fixture(scope='session')
def bags(workspace) -> Path:
    """One bag of about 120 ticks with cameras, driven by the rule driver with noise."""
    folder = workspace / 'bags'
    config = CollectConfig(('LaneFollowing',), ticks=120, episode_ticks=60)
    for _ in collect(folder, config, rule_driver(0.1), {'driver': 'rule'}):
        pass
    return folder


@pytest.fixture(scope='session')
def bag(bags) -> Path:
    return next(p.parent for p in bags.rglob('metadata.yaml'))


@pytest.fixture(scope='session')
def teacher_run(workspace, bags) -> Path:
    run = workspace / 'stage1'
    train('privileged', run, [bags], workspace / 'cache', 10, 'nano', NANO)
    return run


@pytest.fixture(scope='session')
def bundle(workspace, bags, teacher_run) -> Path:
    run = workspace / 'stage2'
    train('raw', run, [bags], workspace / 'cache', 5, 'nano', NANO, teacher_run)
    export_bundle(run, workspace / 'bundle')
    return workspace / 'bundle'
