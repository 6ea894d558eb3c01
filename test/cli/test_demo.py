"""`raw2drive demo` removes what an earlier one made only once nothing is wrong any more, and says where it drives."""

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts.errors import GraphError
from raw2drive_ros.graph import drive, processes
from raw2drive_ros.graph.processes import reserve_domain
from raw2drive_ros.recording import bag_writer


@pytest.fixture
def earlier(tmp_path):
    """The folder of an earlier demo."""
    folder = tmp_path / 'demo'
    (folder / 'bag').mkdir(parents=True)
    (folder / 'bag' / 'metadata.yaml').write_text('of an earlier demo')
    (folder / 'result.json').write_text('{}')
    return folder


def everything(folder) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob('*'))


@pytest.mark.parametrize(
    ('words', 'code', 'message'),
    [
        (['--fault', 'typo'], 2, "unknown plan 'typo'"),
        (['--fault', 'camera frozen', '--fault-plans', 'typo'], 2, "unknown fault plans 'typo'"),
        (['--fault', 'camera frozen', '--image-transport', 'compressed'], 2, '--fault goes with raw images'),
        (['--routes', 'Typo/1'], 2, "unknown scenario 'Typo'"),
        (['--routes', 'LaneFollowing'], 2, 'LaneFollowing'),
        (['--routes', 'LaneFollowing/1/Typo'], 2, "unknown weather 'Typo'"),
        (['--bundle', 'BROKEN'], 1, 'bundle'),
        (['--domain', '300'], 2, '300'),
    ],
)
def test_whatever_is_wrong_the_earlier_demo_stays(earlier, words, code, message, tmp_path, capsys) -> None:
    broken = tmp_path / 'broken'
    broken.mkdir()
    (broken / 'bundle.json').write_text('{}')
    before = everything(earlier)
    words = [str(broken) if word == 'BROKEN' else word for word in words]
    try:
        found = main(['demo', '--out', str(earlier), *words])
    except SystemExit as stop:
        found = stop.code
    assert found == code
    assert message in capsys.readouterr().err
    assert everything(earlier) == before


def test_neither_a_full_disk_nor_a_busy_domain_removes_it(earlier, monkeypatch, capsys) -> None:
    before = everything(earlier)
    with reserve_domain(None) as domain:
        assert main(['demo', '--out', str(earlier), '--domain', str(domain)]) == 1
    assert 'is used by another raw2drive graph' in capsys.readouterr().err
    monkeypatch.setattr(bag_writer.shutil, 'disk_usage', lambda path: type('', (), {'free': 1})())
    assert main(['demo', '--out', str(earlier)]) == 1
    assert '0 MB free' in capsys.readouterr().err
    assert everything(earlier) == before


def test_it_says_its_domain_and_takes_that_of_the_environment(earlier, monkeypatch, capsys) -> None:
    with reserve_domain(None) as free:
        pass
    driven = []

    def drive_graph(job, domain, advance):
        driven.append(domain)
        assert everything(earlier) == [], 'the earlier demo is removed by now'
        raise GraphError('no further')

    monkeypatch.setattr(drive, 'drive_graph', drive_graph)
    monkeypatch.setattr(processes, 'DOMAINS', range(free, 90))
    monkeypatch.setenv('ROS_DOMAIN_ID', str(free))
    assert main(['demo', '--out', str(earlier)]) == 1
    assert driven == [free]
    assert f'driving in ROS domain {free}\n' in capsys.readouterr().err
