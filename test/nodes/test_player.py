"""The player: pause, step, seek, rate and loop, as seen on /clock."""

import itertools
import json
import subprocess
import sys
from pathlib import Path

from raw2drive_ros.graph.processes import reserve_domain, running_graph
from raw2drive_ros.recording.bag_reader import begin_ns, open_bag

PROBE = Path(__file__).with_name('player_probe.py')
ROOT = PROBE.parents[2]


def test_a_player_pauses_steps_seeks_and_loops(bag, tmp_path) -> None:
    with open_bag(bag) as reader:
        start_ns, end_ns = begin_ns(reader), reader.end_time
    with reserve_domain(None) as domain, running_graph(tmp_path, domain) as graph:
        parameters = {'bag': str(bag), 'paused': True, 'loop': True, 'wait_for_subscribers': 0}
        graph.start('player', parameters, sim_time=False)
        probe = subprocess.run(
            [sys.executable, str(PROBE)], cwd=ROOT, env=graph.environment, capture_output=True, text=True, timeout=120
        )
        assert probe.returncode == 0, probe.stderr[-2000:]
        graph.check()
    observed = json.loads(probe.stdout.splitlines()[-1])
    assert observed['step while paused'] is True
    assert len(observed['one step']) == 1
    assert observed['nothing'] == observed['paused'] == []
    assert (observed['wrong rate'], observed['rate'], observed['start']) == (False, True, True)
    playing = observed['playing']
    assert playing == sorted(playing)
    assert 1.4e9 < playing[-1] - playing[0] < 2.3e9, 'twice as fast as recorded'
    assert observed['after seek'] == [start_ns + 500_000_000]
    assert observed['step while playing'] is False
    again = observed['again']
    assert max(again) <= end_ns
    back = [b for a, b in itertools.pairwise(again) if b < a]
    assert back[0] == start_ns + 500_000_000, 'a loop starts again at start_s'
