"""Every error class of the project. A `UserError` becomes one line on stderr and its `exit_code`; see `cli.guard`.

Each class also inherits from the matching built-in exception (ValueError, OSError, ...), for callers that do not know
this module.
"""

from __future__ import annotations


class UserError(Exception):
    """An error that a user can cause and fix. The message says what is wrong, where, and what to do."""

    exit_code = 1


class UsageError(UserError, ValueError):
    """Options of the command line are missing, wrong or contradict one another."""

    exit_code = 2


# -- data and configuration -------------------------------------------------------------------------


class ContractError(UserError, ValueError):
    """A value breaks the contract of the type that holds it."""


class ConfigError(UserError, ValueError):
    """A configuration file is missing or wrong; the message says which and what."""

    exit_code = 2


class KeyFileError(UserError, RuntimeError):
    """The file of the key for signatures cannot be used; the message says why and what to do."""


class RuntimeFolderError(UserError, OSError):
    """The user's runtime folder cannot be trusted or made; the message says which and why."""


class PrivilegedImportError(ImportError):
    """Something in the planner's process tried to reach privileged code or data."""


# -- simulation -------------------------------------------------------------------------------------


class UnknownScenarioError(UserError, KeyError):
    """No scenario of that name; the message says which are near, or lists the known ones."""

    exit_code = 2

    def __str__(self) -> str:
        return str(self.args[0])


class UnknownWeatherError(UserError, ValueError):
    """No weather of that name; the message lists the known ones."""

    exit_code = 2


class RouteIdError(UserError, ValueError):
    """A text that is not a valid route id."""

    exit_code = 2


class LayoutError(UserError, ValueError):
    """Pieces of a road layout overlap."""


class UnfairScenarioError(UserError, RuntimeError):
    """Too few draws of a scenario type are fair: the type itself needs fixing."""


# -- bags -------------------------------------------------------------------------------------------


class BagError(UserError, RuntimeError):
    """A bag cannot be used; the message says which, why, and what to do."""


class BagExistsError(UserError, FileExistsError):
    """The target bag, or what a killed recorder left of it, already exists; neither is ever overwritten."""


class DiskFullError(UserError, OSError):
    """Too little free space on the disk; the message says how much is left and how much is needed."""


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


class DriverClassError(UserError, ValueError):
    """A driver given as `package.module:Class` cannot be used; the message says what its class lacks."""

    exit_code = 2


class DriverFailedError(UserError, RuntimeError):
    """A driver given as a class raised, returned no command, ended or did not answer during a drive."""


class UnknownSuiteError(UserError, ValueError):
    """No suite of that name; the message lists the known ones."""

    exit_code = 2


class ResultsError(UserError, RuntimeError):
    """A file of results is damaged, belongs to another evaluation, or cannot be compared with another one."""


class SoakError(UserError, RuntimeError):
    """A file does not hold soak samples."""


# -- graph and vehicles -----------------------------------------------------------------------------


class NodeError(UserError, RuntimeError):
    """A node cannot do its work; one line says why and what to do."""


class GraphError(UserError, RuntimeError):
    """A process of the graph failed; the message says how it ended."""


class DomainBusyError(UserError, RuntimeError):
    """The ROS domain is out of range or in use by another raw2drive graph."""


class UnsafeError(UserError, RuntimeError):
    """Moving the car any further would be unsafe; the message says why."""


class CarlaError(UserError, RuntimeError):
    """The CARLA server cannot be used; the message says why."""


class SensorTimeoutError(UserError, RuntimeError):
    """A sensor of the CARLA server did not deliver in time; the message says which."""
