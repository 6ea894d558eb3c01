"""The parts of `raw2drive suite` that draw, compare and attack suites."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raw2drive_ros.cli.parser import note
from raw2drive_ros.contracts.errors import UsageError

if TYPE_CHECKING:
    from raw2drive_ros.evaluation.cheat_tuning import TuneSettings
    from raw2drive_ros.evaluation.cheats import Tuned
    from raw2drive_ros.evaluation.reference import References
    from raw2drive_ros.evaluation.scene_distance import Nearest
    from raw2drive_ros.evaluation.suite_audit import AuditRow, Cell
    from raw2drive_ros.evaluation.suites import Suite

HISTOGRAM_BINS = 10
BAR_COLUMNS = 40


def build(options: argparse.Namespace) -> int:
    """Draw a suite and write its file."""
    from raw2drive_ros.contracts.near_names import did_you_mean
    from raw2drive_ros.evaluation.suite_build import build_suite, write_suite
    from raw2drive_ros.evaluation.suite_plans import suite_plans
    from raw2drive_ros.progress import bar

    plans = suite_plans()
    if options.name not in plans or options.out is None:
        near = did_you_mean(options.name or '', plans)
        raise UsageError(f'suite build needs one of {", ".join(plans)} and --out FILE{near}')
    plan = plans[options.name]
    if not plan.types:
        raise UsageError(f'suite build {options.name}: no scenario type of this version belongs to it')
    references = _references(options)
    journal = options.out.with_name(f'.{options.out.name}.examined.jsonl')
    total = plan.per_type * len(plan.types)
    with bar(f'drawing {options.name}', total, 'routes') as advance:
        built = build_suite(plan, references, journal, options.workers, advance)
    write_suite(options.out, options.name, options.version, plan, built, references)
    journal.unlink(missing_ok=True)
    count = sum(built.rejected.values())
    reasons = ', '.join(f'{number} {reason}' for reason, number in built.rejected.items())
    share = f'{count} of {total + count} draws rejected ({100.0 * count / (total + count):.1f} %)'
    print(f'{options.out}: {total} routes; {share}{": " if reasons else ""}{reasons}')
    return 0


def compare(options: argparse.Namespace) -> int:
    """The nearest scene of another suite, for each route of one. Exit code 1 for duplicates and near-copies."""
    from raw2drive_ros.evaluation.scene_distance import DUPLICATE, NEAR_COPY, nearest_scenes, total_scenes
    from raw2drive_ros.evaluation.suites import load_suite
    from raw2drive_ros.progress import bar

    if options.other is None:
        raise UsageError('suite distance needs two suites, e.g. raw2drive suite distance b2d220 train')
    a, b = load_suite(options.name), load_suite(options.other)
    with bar('drawing scenes', total_scenes(a, b), 'scenes') as advance:
        found = nearest_scenes(a, b, on_scene=advance)
    bad = [scene for scene in found if scene.verdict in (DUPLICATE, NEAR_COPY)]
    if options.json:
        print(json.dumps({'a': a.name, 'b': b.name, 'scenes': [asdict(scene) for scene in found]}))
    else:
        _print_distances(a.name, b.name, found)
    if bad:
        listed = ', '.join(f'{s.type}/{s.seed} is a {s.verdict} of {s.type}/{s.other}' for s in bad[:5])
        note(f'refused: {len(bad)} of {len(found)} scenes of {a.name}: {listed}{", ..." if len(bad) > 5 else ""}')
    return 1 if bad else 0


def tune_drivers(options: argparse.Namespace) -> int:
    """Choose on training routes how the sightless drivers drive, and write it to a folder."""
    from raw2drive_ros.evaluation.cheats import load_tuned, save_tuned
    from raw2drive_ros.evaluation.suites import load_suite

    if options.name is None or options.out is None:
        raise UsageError('suite tune needs a suite of training routes and --out FOLDER')
    train = load_suite(options.name)
    types = _types(options, train)
    before = load_tuned(options.out) if (options.out / 'choices.json').is_file() else None
    tuned = _search(options, train, types, _settings(options), before, options.out)
    save_tuned(options.out, tuned)
    _print_choices(tuned, types)
    return 0


def audit_suite(options: argparse.Namespace) -> int:
    """Drive the sightless drivers over a suite. Exit code 1 when they win too much of it."""
    from raw2drive_ros.evaluation.cheats import SCRIPT, load_tuned, shipped
    from raw2drive_ros.evaluation.suite_audit import HINDSIGHT, audit, faults_of, first_differences, table_of
    from raw2drive_ros.evaluation.suites import load_suite
    from raw2drive_ros.progress import bar

    if options.name is None:
        raise UsageError('suite audit needs a suite, e.g. raw2drive suite audit b2d220')
    suite = load_suite(options.name)
    types = _types(options, suite)
    drivers = _drivers(options)
    tuned = shipped() if options.choices is None else load_tuned(options.choices)
    known = tuned.choices.get(SCRIPT, {})
    unknown = [kind for kind in types if options.search or kind not in known]
    if unknown:
        note(f'tuning {len(unknown)} types on routes of {options.train} first')
        settings = _settings(options, timed=bool(suite.timings))
        tuned = _search(options, load_suite(options.train), unknown, settings, tuned, None)
    wanted = (*drivers, HINDSIGHT) if options.hindsight else drivers
    pairs = [pair for pair in suite.pairs if pair.type in types]
    with bar('attacking', len(pairs), 'pairs') as advance:
        rows = list(audit(suite, tuned, wanted, types, options.workers, advance))
    if options.out is not None:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(''.join(json.dumps(asdict(row)) + '\n' for row in rows))
    table = table_of(rows)
    faults = faults_of(table)
    alike = first_differences(suite, types)
    if options.json:
        told = {'alike_until': {one.type: str(one) for one in alike}}
        print(json.dumps(_as_json(suite, rows, table, faults) | told))
    else:
        _print_audit(suite, table, {one.type: str(one) for one in alike})
    for fault in faults:
        note(f'too soft: {fault}')
    return 1 if faults else 0


# -- options ----------------------------------------------------------------------------------------


def _references(options: argparse.Namespace) -> References:
    """Raises UnknownDriverError."""
    from raw2drive_ros.evaluation.drivers import driver_entry
    from raw2drive_ros.evaluation.reference import FALLBACK, References

    driver_entry(options.reference)
    if options.fallback not in ('', FALLBACK):
        driver_entry(options.fallback)
    return References(options.reference, options.fallback)


def _settings(options: argparse.Namespace, *, timed: bool = True) -> TuneSettings:
    from raw2drive_ros.evaluation.cheat_tuning import TuneSettings

    return TuneSettings(_references(options), options.pairs, timed)


def _types(options: argparse.Namespace, suite: Suite) -> list[str]:
    """Raises UsageError for a type of which the suite has no route."""
    from raw2drive_ros.contracts.near_names import unknown_name

    known = list(dict.fromkeys(route.type for route in suite.routes))
    if options.types is None:
        return known
    chosen = options.types.split(',')
    for kind in chosen:
        if kind not in known:
            raise UsageError(unknown_name('type', kind, known, f' (of suite {suite.name})'))
    return list(dict.fromkeys(chosen))


def _drivers(options: argparse.Namespace) -> tuple[str, ...]:
    """Raises UsageError."""
    from raw2drive_ros.contracts.near_names import unknown_name
    from raw2drive_ros.evaluation.cheats import SIGHTLESS

    chosen = SIGHTLESS if options.drivers is None else tuple(dict.fromkeys(options.drivers.split(',')))
    for name in chosen:
        if name not in SIGHTLESS:
            raise UsageError(unknown_name('sightless driver', name, SIGHTLESS))
    return chosen


def _search(
    options: argparse.Namespace,
    train: Suite,
    types: Sequence[str],
    settings: TuneSettings,
    before: Tuned | None,
    folder: Path | None,
) -> Tuned:
    """Tune types with a progress bar. folder: gets what was found after every type."""
    from raw2drive_ros.evaluation.cheat_tuning import together, tune
    from raw2drive_ros.evaluation.cheats import Tuned, save_tuned
    from raw2drive_ros.progress import bar

    tuned = before or Tuned()
    with bar('tuning', len(types), 'types') as advance:
        for found in tune(train, types, settings, options.workers, advance):
            tuned = together([found], tuned)
            if folder is not None:
                save_tuned(folder, tuned)
    return tuned


# -- printing ---------------------------------------------------------------------------------------


def _print_distances(a: str, b: str, found: list[Nearest]) -> None:
    from rich.table import Table

    from raw2drive_ros.cli.table import add_column, wide_console

    table = Table(title=f'nearest scene of {b} to each of {a}')
    for column in ('type', 'scenes', 'nearest', 'median', 'duplicates and near-copies', 'not comparable'):
        add_column(table, column, right=column != 'type')
    for kind in dict.fromkeys(scene.type for scene in found):
        of_type = [scene for scene in found if scene.type == kind]
        known = sorted(scene.distance for scene in of_type if scene.distance is not None)
        bad = sum(scene.verdict in ('duplicate', 'near-copy') for scene in of_type)
        least, median = (f'{known[0]:.3f}', f'{known[len(known) // 2]:.3f}') if known else ('-', '-')
        table.add_row(kind, str(len(of_type)), least, median, str(bad), str(len(of_type) - len(known)))
    wide_console().print(table)
    distances = [scene.distance for scene in found if scene.distance is not None]
    for number in range(HISTOGRAM_BINS if distances else 0):
        low, high = number / HISTOGRAM_BINS, (number + 1) / HISTOGRAM_BINS
        last = number == HISTOGRAM_BINS - 1
        count = sum(low <= distance < high or (last and distance >= high) for distance in distances)
        print(f'{low:.1f} to {high:.1f} of the range {count:5d} {"#" * round(BAR_COLUMNS * count / len(distances))}')


def _print_choices(tuned: Tuned, types: Sequence[str]) -> None:
    from rich.table import Table

    from raw2drive_ros.cli.table import add_column, wide_console
    from raw2drive_ros.evaluation.cheats import SCRIPT

    table = Table(title='what wins most training routes')
    for column in ('type', 'driver', 'won', 'of', 'how'):
        add_column(table, column, right=column in ('won', 'of'))
    for kind in types:
        if kind in tuned.choices.get(SCRIPT, {}):
            best = tuned.choices[SCRIPT][kind]
            table.add_row(kind, best.family, str(best.won), str(best.of), json.dumps(best.way.stored()))
    wide_console().print(table)


def _as_json(
    suite: Suite, rows: list[AuditRow], table: dict[str, dict[str, Cell]], faults: list[str]
) -> dict[str, Any]:
    from raw2drive_ros.evaluation.suite_audit import percent_of, soft_types

    return {
        'suite': suite.name,
        'version': suite.version,
        'drivers': {
            driver: {
                'pair_success_percent': round(percent_of(cells.values()), 2),
                'soft_types': soft_types(cells),
                'types': {kind: asdict(cell) for kind, cell in cells.items()},
            }
            for driver, cells in table.items()
        },
        'pairs': [asdict(row) for row in rows],
        'faults': faults,
    }


def _print_audit(suite: Suite, table: dict[str, dict[str, Cell]], alike: dict[str, str]) -> None:
    """Pairs won per type and driver, and in all. alike: type -> how far event and twin look alike."""
    from rich.table import Table

    from raw2drive_ros.cli.table import add_column, wide_console
    from raw2drive_ros.evaluation.suite_audit import bar_percent, percent_of

    shown = Table(title=f'pairs of {suite.name} version {suite.version} won without looking')
    for column in ('type', *table, 'twin alike until'):
        add_column(shown, column, right=column != 'type')
    for kind in dict.fromkeys(kind for cells in table.values() for kind in cells):
        cells = [of_type[kind] for of_type in table.values()]
        shown.add_row(
            kind, *(f'{cell.pairs}/{cell.of}' if cell.pairs else '-' for cell in cells), alike.get(kind, 'no twin')
        )
    shown.add_section()
    shown.add_row('pair success %', *(f'{percent_of(cells.values()):.1f}' for cells in table.values()))
    shown.add_row('at most', *(f'{bar_percent(driver):.0f}' for driver in table))
    wide_console().print(shown)
