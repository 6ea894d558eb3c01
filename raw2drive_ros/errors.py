"""Every error class of the project. A `UserError` becomes one line on stderr and its `exit_code`; see `cli.guard`.

They also keep the built-in kind that they are of (ValueError, OSError, ...), for callers that know nothing of this
project.
"""

from __future__ import annotations


class UserError(Exception):
    """Something that a user can cause and mend. The message says what is wrong, where, and what to do."""

    exit_code = 1


class UsageError(UserError, ValueError):
    """The command line asks for something that does not go together."""

    exit_code = 2


# -- borders ----------------------------------------------------------------------------------------


class ContractError(UserError, ValueError):
    """A value breaks the contract of the type that holds it."""


class ConfigError(UserError, ValueError):
    """A configuration file is missing or wrong; the message says which and what."""

    exit_code = 2


class PrivilegedImportError(ImportError):
    """Something in the planner's process tried to reach privileged code or data."""


# -- simulation -------------------------------------------------------------------------------------


class UnknownScenarioError(UserError, KeyError):
    """No scenario of that name; the message lists the known ones."""

    exit_code = 2

    def __str__(self) -> str:
        return str(self.args[0])


class UnknownWeatherError(UserError, ValueError):
    """No weather of that name; the message lists the known ones."""

    exit_code = 2


class RouteIdError(UserError, ValueError):
    """Text that names no route."""

    exit_code = 2


class LayoutError(UserError, ValueError):
    """The pieces of a road layout run into one another."""


class UnfairScenarioError(UserError, RuntimeError):
    """Hardly any draw of a scenario type is fair: the type needs mending."""


# -- bags -------------------------------------------------------------------------------------------


class BagError(UserError, RuntimeError):
    """A bag cannot be used; the message says which, why, and what to do."""


class BagExistsError(UserError, FileExistsError):
    """The target bag exists already, or what a killed recorder left of it; neither is ever overwritten."""


class DiskFullError(UserError, OSError):
    """Less than the stated space is left on the disk."""


# -- models and training ----------------------------------------------------------------------------


class BundleError(UserError, RuntimeError):
    """A bundle is missing, damaged, or does not fit; the message says what differs."""


class CheckpointError(UserError, RuntimeError):
    """A checkpoint is missing, damaged, or belongs to another configuration."""


class NonFiniteError(UserError, FloatingPointError):
    """A loss or gradient became NaN or infinite; the weights are still those of the last good step."""


# -- evaluation -------------------------------------------------------------------------------------


class UnknownDriverError(UserError, ValueError):
    """No driver of that name; the message lists the known ones."""

    exit_code = 2


class UnknownSuiteError(UserError, ValueError):
    """No suite of that name; the message lists the known ones."""

    exit_code = 2


class ResultsError(UserError, RuntimeError):
    """A file of results is damaged, belongs to another evaluation, or cannot be compared with another one."""


class SoakError(UserError, RuntimeError):
    """A file of soak samples that is not one."""


# -- graph and vehicles -----------------------------------------------------------------------------


class NodeError(UserError, RuntimeError):
    """A node cannot do its work; one line says why and what to do."""


class GraphError(UserError, RuntimeError):
    """A process of the graph failed; the message has its last words."""


class DomainBusyError(UserError, RuntimeError):
    """The ROS domain is used by another graph of ours."""


class UnsafeError(UserError, RuntimeError):
    """The car must not be moved on; the message says why."""


class CarlaError(UserError, RuntimeError):
    """The CARLA server cannot be used; the message says why."""


class SensorTimeoutError(UserError, RuntimeError):
    """A sensor of the CARLA server did not deliver in time; the message says which."""
