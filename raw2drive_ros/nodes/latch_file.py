"""Keeps the reason of a gate's stop in the user's runtime folder, for the gate that is started after it."""

from __future__ import annotations

from pathlib import Path

from raw2drive_ros.artifact import write_whole
from raw2drive_ros.runtime_folder import runtime_folder

LONGEST = 500


class LatchFile:
    """One file per ROS domain and gate; a restart of the machine removes it, as it does every process that knew why."""

    def __init__(self, domain: int, node_name: str) -> None:
        """Raises RuntimeFolderError."""
        self.path = Path(runtime_folder() / f'latch_{domain}{node_name.replace("/", "_")}')

    def read(self) -> str:
        """Why the car was stopped, '' where it was not. A file that cannot be read is a stop without a reason."""
        try:
            return self.path.read_text(errors='replace')[:LONGEST] or 'unknown'
        except FileNotFoundError:
            return ''
        except OSError as error:
            return f'unknown ({error.strerror})'

    def write(self, reason: str) -> None:
        write_whole(self.path, reason[:LONGEST])

    def clear(self) -> None:
        self.path.unlink(missing_ok=True)
