"""How every node process starts, spins and ends."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from raw2drive_ros.contracts.errors import UserError
from raw2drive_ros.nodes.transport import configure_transport, end_with_parent, warn


class StopRequest:
    """SIGINT and SIGTERM as a flag, for nodes that have work to finish before their context may end."""

    def __init__(self) -> None:
        self.requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._request)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True


def steady_clock() -> Clock:
    """A clock for timers that must neither stop with a paused simulation nor jump with the system clock."""
    return Clock(clock_type=ClockType.STEADY_TIME)


def spin(node: Node, executor: SingleThreadedExecutor, until: Callable[[], bool] = lambda: False) -> None:
    """Spin until the context ends or `until()`; a callback that raises is logged and does not end the spin."""
    while rclpy.ok() and not until():
        try:
            executor.spin_once(timeout_sec=0.2)
        except (KeyboardInterrupt, ExternalShutdownException):
            raise
        except Exception as error:
            node.get_logger().error(f'callback failed: {type(error).__name__}: {error}')


def run_node(make: Callable[[], Any], args: list[str] | None = None) -> int:
    """Run a node to its end and return the exit code.

    The node may have `run(executor)` and `close()`. If its class sets `drains`, SIGINT and SIGTERM only set the
    attribute `stop` of the node, which ends by itself.
    """
    warn(configure_transport())
    # Shells start background jobs with SIGINT ignored; a recorder that ignores Ctrl-C never closes its bag.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    code = 0
    node: Any = None
    if not end_with_parent():
        return 1
    drains = getattr(make, 'drains', False)
    stop = StopRequest() if drains else None
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO if drains else None)
    except RuntimeError as error:
        # Wrong --ros-args, or a keystore of SROS2 that is not there.
        print(f'error: {" ".join(str(error).split())}', file=sys.stderr)
        return 1
    try:
        node = make()
        node.stop = stop
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if hasattr(node, 'run'):
            node.run(executor)
        else:
            spin(node, executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (UserError, OSError, RuntimeError, ValueError) as error:
        if rclpy.ok():
            print(f'error: {" ".join(str(error).split())}', file=sys.stderr)
            code = 1
    finally:
        # A second Ctrl-C must not interrupt the clean-up.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            if hasattr(node, 'close'):
                node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return code
