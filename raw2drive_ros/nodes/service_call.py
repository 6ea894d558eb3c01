"""Calls one service of a running node and ends: for people who have no `ros2` command."""

from __future__ import annotations

import json
import re
import time
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import SetBool, Trigger

from raw2drive_ros.contracts.errors import NodeError
from raw2drive_ros.contracts.near_names import did_you_mean
from raw2drive_ros.nodes.parameters import declare
from raw2drive_ros.nodes.runtime import run_node

TYPES = {
    'std_srvs/srv/Trigger': Trigger,
    'std_srvs/srv/SetBool': SetBool,
    'lifecycle_msgs/srv/ChangeState': ChangeState,
}
WORDS = {'true': True, 'on': True, 'yes': True, 'false': False, 'off': False, 'no': False}
TRANSITIONS = ('configure', 'activate', 'deactivate', 'cleanup', 'shutdown')
WHOLE, INT64 = re.compile('[-+]?[0-9]{1,19}'), 2**63
# Discovery usually takes a fraction of a second; a node whose first announcements are missed is found 3 s later.
LOOK_S, SETTLE_S, ANSWER_S = 8.0, 4.0, 60.0


class ServiceCallNode(Node):
    """Prints the answer on stdout. Raises NodeError when there is no such service, and when it refuses."""

    def __init__(self) -> None:
        super().__init__('service_call')
        self.p = declare(
            self,
            {
                'service': ('', 'full name; empty: list what can be called'),
                'argument': ('', 'true or false for a SetBool, a transition for a ChangeState'),
                'set': ('', "JSON mapping of the node's parameters to set before, on one line"),
            },
        )

    def run(self, executor: SingleThreadedExecutor) -> None:
        self.executor_ = executor
        if not self.p['service']:
            self._list()
            return
        service = self.p['service']
        type_name = self._find(service)
        request = self._request(type_name)
        texts = json.loads(self.p['set'] or '{}')
        if texts:
            self._set(service.rpartition('/')[0], texts)
        client = self.create_client(TYPES[type_name], service)
        answer = self._wait(client.call_async(request) if client.wait_for_service(LOOK_S) else None, service)
        refused = 'refused; why is in the log of the node, and on /diagnostics'
        text = getattr(answer, 'message', '') or ('done' if answer.success else refused)
        if not answer.success:
            raise NodeError(f'{service}: {text}')
        print(text, flush=True)

    def _list(self) -> None:
        found: dict[str, str] = {}
        started = changed = time.monotonic()
        # Until nothing new appears: nodes are discovered one after another.
        while time.monotonic() < (changed + SETTLE_S if found else started + LOOK_S):
            self.executor_.spin_once(timeout_sec=0.1)
            now = self._callable()
            if now != found:
                found, changed = now, time.monotonic()
        if not found:
            raise NodeError('no service in this domain that could be called; is a graph running, is --domain its own?')
        for name, type_name in sorted(found.items()):
            print(f'{name:34} {type_name.replace("/srv/", "/")}', flush=True)

    def _callable(self) -> dict[str, str]:
        known = self.get_service_names_and_types()
        # The ROS graph also lists services that have clients only.
        return {name: types[0] for name, types in known if types[0] in TYPES and self.count_services(name)}

    def _find(self, service: str) -> str:
        deadline = time.monotonic() + LOOK_S
        while time.monotonic() < deadline:
            types = dict(self.get_service_names_and_types()).get(service)
            if types and self.count_services(service):
                if types[0] not in TYPES:
                    raise NodeError(f'{service} is a {types[0]}; only {", ".join(TYPES)} can be called')
                return types[0]
            self.executor_.spin_once(timeout_sec=0.1)
        known = sorted(self._callable())
        there = ', '.join(known) or 'none at all: is a graph running, is --domain its own?'
        raise NodeError(f'no service {service} in this domain{did_you_mean(service, known) or ";"} there are: {there}')

    def _request(self, type_name: str) -> Any:
        argument = self.p['argument']
        request = TYPES[type_name].Request()
        if type_name.endswith('SetBool'):
            if argument.lower() not in WORDS:
                raise NodeError(f'{self.p["service"]} wants true or false')
            request.data = WORDS[argument.lower()]
        elif type_name.endswith('ChangeState'):
            if argument not in TRANSITIONS:
                raise NodeError(f'{self.p["service"]} wants a transition: {", ".join(TRANSITIONS)}')
            # The node looks a transition up by its label when the id is unknown.
            request.transition.id, request.transition.label = 255, argument
        elif argument:
            raise NodeError(f'{self.p["service"]} takes no argument')
        return request

    def _set(self, node_name: str, texts: dict[str, str]) -> None:
        """Set all of the parameters, or none."""
        client = AsyncParameterClient(self, node_name)
        if not client.wait_for_services(LOOK_S):
            raise NodeError(f'{node_name} does not answer')
        parameters = []
        for name, text in texts.items():
            # One by one: a node returns no types at all when one of several names is unknown to it.
            kinds = self._wait(client.get_parameter_types([name]), node_name).types
            if not kinds or kinds[0] == ParameterType.PARAMETER_NOT_SET:
                raise NodeError(f'{node_name} has no parameter {name}')
            try:
                parameters.append(Parameter(name, value=_value(text, kinds[0])))
            except ValueError as error:
                raise NodeError(f'{name}: {error}') from error
        result = self._wait(client.set_parameters_atomically(parameters), node_name).result
        if not result.successful:
            raise NodeError(f'nothing was set: {result.reason}')

    def _wait(self, future: Any, who: str) -> Any:
        if future is not None:
            rclpy.spin_until_future_complete(self, future, self.executor_, timeout_sec=ANSWER_S)
        if future is None or not future.done():
            raise NodeError(f'{who} does not answer')
        return future.result()


def _value(text: str, kind: int) -> Any:
    """The text as a parameter of that type. Raises ValueError."""
    if kind == ParameterType.PARAMETER_STRING:
        return text
    if kind == ParameterType.PARAMETER_BOOL:
        if text.lower() not in WORDS:
            raise ValueError(f'{text!r} is neither true nor false')
        return WORDS[text.lower()]
    if kind == ParameterType.PARAMETER_INTEGER:
        if not WHOLE.fullmatch(text) or not -INT64 <= int(text) < INT64:
            raise ValueError(f'{text!r} is no whole number, or too large a one')
        return int(text)
    if kind == ParameterType.PARAMETER_DOUBLE:
        return float(text)
    raise ValueError('only numbers, words and true or false can be set from here')


def main(args: list[str] | None = None) -> int:
    """Run one service call and return the exit code."""
    return run_node(ServiceCallNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
