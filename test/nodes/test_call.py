"""`raw2drive call`: services of running nodes, refusals, and unknown names."""

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.graph.processes import reserve_domain, running_graph


def test_services_are_listed_called_and_refuse_with_a_reason(bag, tmp_path, capsys) -> None:
    def call(*words: str) -> tuple[int, str]:
        code = main(['call', *words, '--domain', str(domain)])
        captured = capsys.readouterr()
        return code, captured.out + captured.err

    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        graph.start('safety_gate', {}, sim_time=False)
        graph.start('player', {'bag': str(bag), 'paused': True, 'wait_for_subscribers': 0}, sim_time=False)
        assert call('/player/pause', 'true') == (0, 'paused at 1000000000 ns\n')
        assert call('/player/step') == (0, 'a step\n')
        code, text = call('/safety_gate/activate')
        assert (code, 'the speed is unknown: no odometry' in text) == (1, True)
        assert call('/player/seek', '--set', 'start_s=3', '--set', 'rate=2') == (0, 'to 3.0 s\n')
        code, text = call()
        assert code == 0
        assert '/safety_gate/activate ' in text
        assert '/player/pause ' in text
        for words, why in (
            (('/player/seek', '--set', 'start_s=-1'), 'start_s'),
            (('/player/seek', '--set', 'stat_s=1'), 'no parameter stat_s'),
            (('/player/seek', '--set', 'start_s=1000'), 'the bag lasts'),
            (('/player/seek', '--set', 'start_s=1e300'), 'start_s'),
            (('/player/seek', '--set', 'start_s=soon'), 'start_s: could not convert'),
            (('/player/seek', '--set', 'rate=3', '--set', 'start_s=-1'), 'nothing was set'),
            (('/player/pause', 'perhaps'), 'true or false'),
            (('/player/step', 'true'), 'no argument'),
            (('/safety_gate/actvate',), 'did you mean /safety_gate/activate?'),
        ):
            code, text = call(*words)
            assert code == 1
            assert why in text
        graph.check()
        # Parameters that were refused together were not set.
        assert call('/player/pause', 'True') == (0, 'paused at 4000000000 ns\n')


@pytest.mark.parametrize('words', [['seek'], ['/player/seek', '--set', 'start_s'], ['--set', 'a=1']])
def test_wrong_usage_is_reported_before_anything_starts(words, capsys) -> None:
    assert main(['call', *words]) == 2
    assert capsys.readouterr().err.startswith('error: ')


def test_where_nobody_is_the_domain_is_named_once(monkeypatch, capsys) -> None:
    with reserve_domain(None) as domain:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        assert main(['call', '/safety_gate/activate']) == 1
    assert capsys.readouterr().err.startswith(f'error: listened in ROS domain {domain}; nothing there: ')
