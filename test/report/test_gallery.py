"""docs/scenarios.md is what `raw2drive scenario gallery` writes, and every type has its picture."""

from pathlib import Path

from raw2drive_ros.evaluation.suite_plans import benchmark_types
from raw2drive_ros.report.gallery import page

DOCS = Path(__file__).resolve().parents[2] / 'docs'


def test_the_committed_page_and_pictures_are_those_of_the_registered_types() -> None:
    assert (DOCS / 'scenarios.md').read_text() == page()
    assert {path.stem for path in (DOCS / 'scenarios').glob('*.jpg')} == set(benchmark_types())
