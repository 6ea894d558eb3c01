"""Documents beside the code: their versions agree, and the index of decision records is complete."""

import re
from pathlib import Path

import pytest
import yaml

from raw2drive_ros import __version__

ROOT = Path(__file__).resolve().parents[1]
RECORDS = sorted(ROOT.glob('docs/adr/[0-9]*.md'))
PARTS = ['Context', 'Decision', 'Consequences', 'Alternatives considered']


def test_the_citation_is_of_this_version_and_its_date() -> None:
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    assert citation['version'] == __version__
    assert f'{__version__} ({citation["date-released"]})' in (ROOT / 'CHANGELOG.rst').read_text()


@pytest.mark.parametrize('path', RECORDS, ids=lambda path: path.stem)
def test_a_decision_record_has_its_parts_and_its_row_in_the_index(path) -> None:
    lines = path.read_text().splitlines()
    number, title = re.fullmatch(r'# (\d{4}): (.+)', lines[0]).groups()
    assert path.name.startswith(f'{number}-')
    status = re.fullmatch(r'Status: ((?:proposed|accepted|superseded by \d{4}), \d{4}-\d\d-\d\d).*', lines[2])[1]
    assert [line[3:] for line in lines if line.startswith('## ')] == PARTS
    row = f'| [{number}]({path.name}) | {title} | {status} |'
    assert row in (ROOT / 'docs/adr/README.md').read_text()


def test_no_line_of_the_changelog_is_longer_than_an_entry_may_be() -> None:
    lines = (ROOT / 'CHANGELOG.rst').read_text().splitlines()
    assert [line for line in lines if len(line) > 120] == []
    continued = [line for line in lines if line.startswith('  ')]
    assert continued == []
