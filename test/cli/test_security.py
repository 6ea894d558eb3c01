"""`raw2drive security policies`: of SROS2's form, and nobody may do more than his part."""

import re
from xml.etree import ElementTree

import pytest

from raw2drive_ros.cli.main import main
from raw2drive_ros.contracts import topics
from raw2drive_ros.graph import processes
from raw2drive_ros.graph.processes import Graph
from raw2drive_ros.graph.security_policy import enclaves

# The schema of policies 0.2.0: element -> (attributes that it must have, that it may have, children, at least one).
SCHEMA = {
    'policy': ({'version'}, set(), {'enclaves'}, True),
    'enclaves': (set(), set(), {'enclave'}, True),
    'enclave': ({'path'}, set(), {'profiles'}, True),
    'profiles': (set(), {'type'}, {'profile'}, True),
    'profile': ({'ns', 'node'}, set(), {'topics', 'services', 'actions'}, False),
    'topics': (set(), {'publish', 'subscribe'}, {'topic'}, True),
    'services': (set(), {'reply', 'request'}, {'service'}, True),
    'topic': (set(), set(), set(), False),
    'service': (set(), set(), set(), False),
}
NAME = re.compile(r'/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')


def breaches(element: ElementTree.Element) -> list[str]:
    """What the schema does not allow in `element` and below."""
    must, may, children, filled = SCHEMA[element.tag]
    found = [f'{element.tag} lacks {name}' for name in must - set(element.attrib)]
    found += [f'{element.tag} has {name}' for name in set(element.attrib) - must - may]
    found += [
        f'{name}={element.get(name)}' for name in may - {'type'} if element.get(name) not in (None, 'ALLOW', 'DENY')
    ]
    found += [f'{child.tag} in {element.tag}' for child in element if child.tag not in children]
    if filled and not len(element):
        found.append(f'{element.tag} is empty')
    if not children and not NAME.fullmatch(element.text or ''):
        found.append(f'{element.tag} {element.text!r}')
    return found + [line for child in element if child.tag in children for line in breaches(child)]


def written(folder, *arguments: str) -> ElementTree.Element:
    assert main(['security', 'policies', '--out', str(folder), *arguments]) == 0
    (path,) = folder.iterdir()
    return ElementTree.parse(path).getroot()


def allowed(root: ElementTree.Element, what: str) -> dict[str, set[str]]:
    """Full name of what is published, subscribed, replied or requested -> nodes that may."""
    found: dict[str, set[str]] = {}
    for profile in root.iter('profile'):
        for rule in profile:
            if rule.get(what) == 'ALLOW':
                for each in rule:
                    name = each.text if each.text.startswith('/') else f'{profile.get("ns").rstrip("/")}/{each.text}'
                    found.setdefault(name, set()).add(profile.get('node'))
    return found


def test_the_file_has_the_form_of_the_schema(tmp_path) -> None:
    root = written(tmp_path / 'out')
    assert breaches(root) == []
    assert root.get('version') == '0.2.0'
    paths = [each.get('path') for each in root.iter('enclave')]
    assert len(paths) == len(set(paths)) == len(enclaves())


@pytest.mark.parametrize(
    ('plant', 'breach'),
    [
        (lambda root: root.attrib.pop('version'), 'policy lacks version'),
        (lambda root: root.find('.//topics').set('publish', 'yes'), 'publish=yes'),
        (lambda root: root.find('.//profile').append(ElementTree.Element('topic')), 'topic in profile'),
        (lambda root: root.find('.//profiles').clear(), 'profiles is empty'),
        (lambda root: setattr(root.find('.//service'), 'text', '~/activate'), "service '~/activate'"),
    ],
)
def test_a_planted_breach_of_the_schema_is_found(tmp_path, plant, breach) -> None:
    root = written(tmp_path / 'out')
    plant(root)
    assert breaches(root) == [breach]


def test_only_the_gate_commands_only_the_operator_activates_and_the_planner_sees_nothing_privileged(tmp_path) -> None:
    root = written(tmp_path / 'out')
    publishers, subscribers = allowed(root, 'publish'), allowed(root, 'subscribe')
    assert publishers[topics.COMMAND] == {'safety_gate'}
    assert publishers[topics.PROPOSED] == {'planner'}
    requests = allowed(root, 'request')
    assert {node for nodes in requests.values() for node in nodes} == {'service_call'}
    assert '/safety_gate/activate' in requests
    assert allowed(root, 'reply')['/safety_gate/activate'] == {'safety_gate'}
    privileged = [spec.name for spec in topics.TOPICS if spec.privileged]
    assert {node for name in privileged for node in publishers.get(name, set())} == {'bridge'}
    assert {node for name in privileged for node in subscribers[name]} == {'recorder', 'vehicle_probe'}
    assert not any('*' in (each.text or '') for each in root.iter()), 'a pattern allows more than is named'


def test_every_topic_of_the_table_has_a_publisher_and_somebody_who_hears_it(tmp_path) -> None:
    root = written(tmp_path / 'out')
    assert set(topics.BY_NAME) - set(allowed(root, 'publish')) == {topics.ADVICE}, 'only the collector writes it'
    assert set(topics.BY_NAME) <= set(allowed(root, 'subscribe'))


def test_cars_in_namespaces_have_enclaves_and_names_of_their_own(tmp_path) -> None:
    root = written(tmp_path / 'out', '--namespace', 'car1')
    assert breaches(root) == []
    assert allowed(root, 'publish')['/car1/control/command'] == {'safety_gate'}
    assert {each.get('path').split('/')[1] for each in root.iter('enclave')} == {'car1'}
    assert [path.name for path in (tmp_path / 'out').iterdir()] == ['car1.policy.xml']


def test_a_policy_that_is_there_is_not_overwritten(tmp_path, capsys) -> None:
    (tmp_path / 'raw2drive.policy.xml').write_text('mine')
    assert main(['security', 'policies', '--out', str(tmp_path)]) == 2
    assert 'exists: remove it' in capsys.readouterr().err
    assert (tmp_path / 'raw2drive.policy.xml').read_text() == 'mine'


def test_nodes_are_started_in_their_enclaves_where_ros_asks_for_security(tmp_path, monkeypatch) -> None:
    started = []
    monkeypatch.setattr(processes.subprocess, 'Popen', lambda command, **options: started.append(command))
    for variables in ({'ROS_SECURITY_ENABLE': 'true'}, {}):
        graph = Graph(tmp_path, variables, '/car1')
        graph.start('safety_gate', {})
        graph.logs[0].close()
    assert started[0][-2:] == ['--enclave', '/car1/safety_gate']
    assert '--enclave' not in started[1]
