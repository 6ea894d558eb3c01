"""The scripts behind the pre-commit hooks: each finds a planted fault, and passes a clean file and this repository."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
MIB = 1 << 20
PACKAGE = (ROOT / 'package.xml').read_text()
# Written in two parts, so that this file holds no key of its own.
PEM = '-----BEGIN {}PRIVATE' + ' KEY{}-----\nMIIE\n'


def check(name: str, *files: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, '.ci/pre_commit_checks.py', name, *map(str, files)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30)


def expect(name: str, path: Path, *faults: str) -> None:
    """Every fault is one line that names the file; nothing else is printed."""
    result = check(name, path)
    assert result.stderr == ''
    assert result.returncode == (1 if faults else 0)
    lines = result.stdout.splitlines()
    assert len(lines) == len(faults), result.stdout
    for line, fault in zip(lines, faults, strict=True):
        assert line.startswith(f'{path}: ')
        assert fault in line


@pytest.mark.parametrize(('size', 'faults'), [(2 * MIB, []), (2 * MIB + 1, ['2.0 MiB']), (5 * MIB, ['5.0 MiB'])])
def test_a_file_over_two_mebibytes_is_found(tmp_path, size, faults) -> None:
    path = tmp_path / 'weights'
    path.write_bytes(bytes(size))
    expect('large-files', path, *faults)


@pytest.mark.parametrize(
    'key',
    [
        PEM.format('', ''),
        PEM.format('RSA ', ''),
        PEM.format('OPENSSH ', ''),
        PEM.format('ENCRYPTED ', ''),
        PEM.format('PGP ', ' BLOCK'),
        'PuTTY-User-Key-' + 'File-3: ssh-ed25519\n',
        'AGE-SECRET-' + 'KEY-1' + 'Q' * 58 + '\n',
    ],
)
def test_a_private_key_is_found_with_its_line(tmp_path, key) -> None:
    path = tmp_path / 'notes.txt'
    path.write_bytes(b'one\n\xff\x00two\n' + key.encode())
    expect('private-keys', path, 'line 3: a private key')


@pytest.mark.parametrize('text', [PEM.format('', '').replace('PRIVATE', 'PUBLIC'), 'where is your PRIVATE KEY?\n', ''])
def test_what_is_no_private_key_passes(tmp_path, text) -> None:
    path = tmp_path / 'notes.txt'
    path.write_text(text)
    expect('private-keys', path)


def moved(line_with: str, before: str) -> str:
    """package.xml with one of its lines elsewhere."""
    lines = PACKAGE.splitlines(keepends=True)
    line = lines.pop(next(i for i, text in enumerate(lines) if line_with in text))
    lines.insert(next(i for i, text in enumerate(lines) if before in text), line)
    return ''.join(lines)


@pytest.mark.parametrize(
    ('text', 'faults'),
    [
        (PACKAGE, []),
        (PACKAGE.replace('  <license>', '  <maintainer email="a@example.org">A</maintainer>\n  <license>'), []),
        (moved('<version>', '<name>'), ['line 5: <name> has to stand before <version>']),
        (moved('<test_depend>', '<exec_depend>std_srvs'), [f'line {line}: <exec_depend>' for line in range(20, 25)]),
        (moved('<license>', '<export>'), ['<license> has to stand before <test_depend>']),
        (PACKAGE.replace('exec_depend>', 'run_depend>', 2), ['line 9: REP 149 knows no <run_depend>']),
        (
            moved('<description>', '</package>').replace('description>', 'summary>'),
            ['missing: description', '<summary>'],
        ),
        (PACKAGE.replace('</package>', ''), ['not XML']),
    ],
)
def test_package_xml_has_its_elements_in_order(tmp_path, text, faults) -> None:
    path = tmp_path / 'package.xml'
    path.write_text(text)
    expect('package-xml', path, *faults)


def test_several_files_are_checked_and_a_missing_one_is_named(tmp_path) -> None:
    clean, absent = tmp_path / 'clean', tmp_path / 'absent'
    clean.write_text('nothing\n')
    for name in ('large-files', 'private-keys', 'package-xml'):
        result = check(name, absent, ROOT / 'package.xml')
        assert result.returncode == 1
        assert result.stdout == f'{absent}: cannot be read: No such file or directory\n'
    assert check('private-keys', clean, ROOT / 'package.xml').returncode == 0


def test_an_unknown_check_is_wrong_usage(tmp_path) -> None:
    assert check('tabs', tmp_path).returncode == 2


def test_every_hook_is_local_and_calls_a_check_that_exists() -> None:
    config = yaml.safe_load((ROOT / '.pre-commit-config.yaml').read_text())
    assert {repo['repo'] for repo in config['repos']} == {'local'}
    hooks = [hook for repo in config['repos'] for hook in repo['hooks']]
    assert {hook['language'] for hook in hooks} == {'system'}
    called = {hook['entry'].split()[-1] for hook in hooks if '.ci/pre_commit_checks.py' in hook['entry']}
    assert called == {'large-files', 'private-keys', 'package-xml'}
