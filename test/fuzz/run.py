"""Coverage-guided fuzzing (atheris) of what users hand in. An input that raises an unexpected error is a find, and is
written to the folder as a file.

python test/fuzz/run.py TARGET [--seconds 600] [--folder /tmp/raw2drive_fuzz]
python test/fuzz/run.py TARGET --again FILE      run the target on a find again

Needs atheris (pip install 'raw2drive_ros[fuzz]').
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

NAMES = ('message', 'bag', 'metadata', 'parameters', 'bundle', 'route', 'results', 'samples', 'suite')
MEMORY_MB, SLOWEST_S = 3000, 10


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('target', choices=NAMES)
    parser.add_argument('--seconds', type=int, default=600)
    parser.add_argument('--folder', type=Path, default=Path('/tmp/raw2drive_fuzz'), help='of the corpus and of finds')
    parser.add_argument('--again', type=Path, help='run this file alone')
    options = parser.parse_args()
    if options.again is not None:
        from targets import TARGETS

        TARGETS[options.target](options.again.read_bytes())
        print('no find')
        return 0
    try:
        import atheris
    except ImportError:
        print("error: atheris is not installed: pip install 'raw2drive_ros[fuzz]'", file=sys.stderr)
        return 1
    with atheris.instrument_imports(include=['raw2drive_ros', 'msg_adapters', 'rosbags', 'mcap', 'targets']):
        from targets import TARGETS
    target = TARGETS[options.target]
    corpus = options.folder / options.target
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(target.seeds()):
        (corpus / f'seed_{number}').write_bytes(seed)
    limits = [f'-max_total_time={options.seconds}', f'-rss_limit_mb={MEMORY_MB}', f'-timeout={SLOWEST_S}']
    atheris.Setup([sys.argv[0], *limits, f'-artifact_prefix={corpus}_find_', '-max_len=20000', str(corpus)], target)
    atheris.Fuzz()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
