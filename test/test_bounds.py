"""Files of unknown origin: what is no regular file, is too large, or multiplies itself when it is read."""

import json
import os
import struct
import sys
from pathlib import Path

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent / 'recording'))

from bounded_process import run_bounded

from raw2drive_ros.bounds import (
    MAX_JSON_BYTES,
    MAX_YAML_BYTES,
    MESSAGES_FLOOR,
    UNPACKED_FLOOR_BYTES,
    Allowance,
    TooLargeError,
    read_json,
    read_regular,
    tensor_shapes,
    yaml_from,
)
from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.texts import shown
from raw2drive_ros.driving.gate_config import load_gate_config
from raw2drive_ros.settings import default_bundle, load_yaml, params_folder

LAUGHS = '\n'.join(f'a{n}: &a{n} [' + ','.join([f'*a{n - 1}' if n else 'lol'] * 9) + ']' for n in range(9)) + '\n'


@pytest.mark.parametrize(
    ('text', 'why'),
    [
        (LAUGHS + 'motion: *a8\n', 'aliases counted'),
        ('<<: *x\nx: &x {a: 1}\n' + LAUGHS, 'aliases counted'),
        ('motion: ' + '[' * 20_000, 'nest'),
        ('motion: ' + '{a: ' * 20_000, 'nested'),
        ('- ' * 20_000, 'nested'),
        ('a: &a [*a]', 'holds itself'),
        ('a: &a {b: [{c: *a}]}', 'holds itself'),
        ('[' + '1,' * 100_000 + ']', 'more than'),
        ('#' * (MAX_YAML_BYTES + 1), 'bytes'),
        ('!!python/object/apply:os.system ["false"]', 'constructor'),
    ],
)
def test_yaml_that_grows_is_one_line(tmp_path, text, why) -> None:
    file = tmp_path / 'gate.yaml'
    file.write_text(text)
    with pytest.raises(ConfigError, match=why) as caught:
        load_yaml(file)
    assert len(str(caught.value)) < 1000
    # The code of a process with limits is what a user would run: nothing but this file is read there.
    code = 'import sys; from pathlib import Path; from raw2drive_ros.settings import load_yaml\n'
    code += 'try:\n load_yaml(Path(sys.argv[1]))\nexcept ValueError as error: print(str(error)[:300])'
    status, said, _ = run_bounded(file, code=code)
    assert status == 0
    assert 'gate.yaml' in said[0]


def test_yaml_with_aliases_is_read_as_before() -> None:
    text = 'a: &a {x: [1, 2.5, yes, null]}\nb: *a\nc: {<<: *a, y: 2026-01-02}\n'
    assert yaml_from(text) == yaml.safe_load(text)
    for file in params_folder().rglob('*.yaml'):
        assert yaml_from(file.read_text()) == yaml.safe_load(file.read_text()), file


@pytest.mark.parametrize('kind', ['fifo', 'device', 'folder', 'missing'])
def test_what_is_no_file_is_one_line_and_does_not_block(tmp_path, kind) -> None:
    file = tmp_path / 'gate.yaml'
    match kind:
        case 'fifo':
            os.mkfifo(file)
        case 'device':
            file.symlink_to('/dev/zero')
        case 'folder':
            file.mkdir()
    why = {'fifo': 'is a FIFO', 'device': 'is a device', 'folder': 'is a folder', 'missing': 'No such file'}[kind]
    with pytest.raises(ConfigError, match=f'cannot read .*{why}'):
        load_gate_config(file)
    with pytest.raises(OSError, match=why):
        read_regular(file, 10)


def test_a_file_whose_size_says_nothing_is_bounded_all_the_same() -> None:
    """Files of /proc have size 0."""
    assert read_regular(Path('/proc/self/stat'), 10_000)
    with pytest.raises(OSError, match='no more than 3'):
        read_regular(Path('/proc/self/stat'), 3)


def test_json_is_bounded(tmp_path) -> None:
    file = tmp_path / 'a.json'
    for text in ('[' * 100_000, '[' + '1,' * MAX_JSON_BYTES + '1]', '9' * 10_000):
        file.write_text(text)
        with pytest.raises((ValueError, OSError)):
            read_json(file)
    file.write_text('{"a": [1]}')
    assert read_json(file) == {'a': [1]}


@pytest.mark.parametrize(
    'content',
    [
        b'',
        struct.pack('<Q', 2**62) + b'{}',
        struct.pack('<Q', 100_000_000) + bytes(100),
        struct.pack('<Q', 2) + b'[]',
        struct.pack('<Q', 12) + b'{"a": {"b":1',
        struct.pack('<Q', 50_000) + b'[' * 50_000,
        struct.pack('<Q', 9) + b'{"a": {}}',
        struct.pack('<Q', 25) + b'{"a": {"shape": ["1e999"]}',
    ],
)
def test_the_header_of_weights_is_bounded_and_checked(tmp_path, content) -> None:
    file = tmp_path / 'weights.safetensors'
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r'header|delimiter|Expecting'):
        tensor_shapes(file, 10**9)
    with pytest.raises(OSError, match='no more than 10 are read'):
        tensor_shapes(default_bundle() / 'weights.safetensors', 10)


def test_an_allowance_grows_with_the_file() -> None:
    Allowance(0).spend(UNPACKED_FLOOR_BYTES, MESSAGES_FLOOR)
    for spent in ((UNPACKED_FLOOR_BYTES + 1, 0), (0, MESSAGES_FLOOR + 1)):
        with pytest.raises(TooLargeError, match='implausibly many'):
            Allowance(0).spend(*spent)
        Allowance(10_000).spend(*spent)


def test_texts_are_shown_without_control_characters() -> None:
    assert shown('/sensing/imu Größe 走') == '/sensing/imu Größe 走'
    assert shown('a\x1b[2J\x07\n\r\u202e\u200b\ud800') == 'a\\x1b[2J\\x07\\n\\r\\u202e\\u200b\\ud800'


def hostile_bundle(folder: Path, weights: str) -> Path:
    body = json.loads((default_bundle() / 'bundle.json').read_text())
    folder.mkdir()
    (folder / 'bundle.json').write_text(json.dumps(body))
    file = folder / 'weights.safetensors'
    match weights:
        case 'fifo':
            os.mkfifo(file)
        case 'device':
            file.symlink_to('/dev/zero')
        case 'folder':
            file.mkdir()
        case 'sparse':
            with file.open('wb') as stream:
                stream.truncate(1_900_000_000)
        case 'header':
            with file.open('wb') as stream:
                stream.write(struct.pack('<Q', 99_000_000))
                stream.truncate(100_000_000)
    return folder


LOAD = """
import resource, sys
from pathlib import Path
from raw2drive_ros.contracts.errors import UserError
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.world_model.teacher import load_teacher
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for load in (load_bundle, load_teacher):
    try:
        load(Path(sys.argv[1]))
    except UserError as error:
        print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.parametrize('weights', ['fifo', 'device', 'folder', 'sparse', 'header', 'missing'])
def test_weights_that_are_no_weights_are_one_line(tmp_path, weights) -> None:
    folder = hostile_bundle(tmp_path / 'bundle', weights)
    # torch maps more than a GiB of address space: here the resident memory counts.
    status, said, errors = run_bounded(folder, code=LOAD, memory_bytes=0)
    assert (status, errors) == (0, [])
    assert len(said) == 3
    assert str(folder) in said[0]
    assert int(said[2]) < 100


def test_a_configuration_that_no_memory_holds_is_refused_before_it_is_built(tmp_path) -> None:
    """The identity is right, as whoever made the bundle can make it: the weights are those of the shipped bundle."""
    code = """
import sys
from pathlib import Path
import json, resource
from raw2drive_ros.driving import bundle
from raw2drive_ros.contracts.errors import BundleError
path = Path(sys.argv[1])
bundle._rig_from_json([])
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for change in json.loads(sys.argv[2]):
    body = json.loads((path / 'bundle.json').read_text())
    body['config'] |= change
    body['identity'] = bundle._identity(body)
    changed = path.parent / 'changed'
    changed.mkdir(exist_ok=True)
    (changed / 'bundle.json').write_text(json.dumps(body))
    target = changed / 'weights.safetensors'
    if not target.exists():
        target.symlink_to(path / 'weights.safetensors')
    try:
        bundle.load_bundle(changed)
        print('loaded')
    except BundleError as error:
        print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""
    (tmp_path / 'good').symlink_to(default_bundle())
    changes = [
        {'deter': 10**9},
        {'deter': 16_000, 'units': 16_000, 'hidden': 16_000},
        {'head_layers': 10**9},
        {'lift_grid': 100_000},
        {'mask_size': 100_000},
        {'image_size': [100_000, 100_000]},
        {'lift_heights_m': [0.0] * 1000},
    ]
    status, said, errors = run_bounded(tmp_path / 'good', json.dumps(changes), code=code, memory_bytes=0)
    assert (status, errors) == (0, [])
    *lines, grown_mib = said
    assert len(lines) == len(changes)
    assert all('damaged bundle' in line for line in lines), lines
    assert int(grown_mib) < 400
