"""Keeps the merger's memory in a file, and takes it up again at the start.

A file that cannot be read is put aside, not overwritten, and the merger starts with nothing: robots
wait for it. A file that cannot be written is told once and tried again after the next merge.
"""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

from topometric_ros.errors import ConfigurationError
from topometric_ros.io.map_format import MapFileError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import EncodedMaps, load_state, save_state


class StateKeeper:
    """The state file of one merger; an empty path keeps nothing.

    Raises
    ------
    ConfigurationError
        The path is that of a folder, a device or a pipe: it must not be put aside or replaced.
    """

    def __init__(self, path: str, logger: Any) -> None:
        self._path = _file(path) if path else None
        self._logger = logger
        self._told = ""
        self._encoded = EncodedMaps()

    def restore(self, session: MergerSession) -> None:
        """Give a session what the file holds, if there is one."""
        if self._path is None:
            return
        if not self._path.exists():
            self._logger.info(f"{self._path}: no state yet, it is written after the first merge")
            return
        try:
            session.restore(load_state(self._path))
        except MapFileError as error:
            aside = self._path.with_name(self._path.name + ".damaged")
            try:
                self._path.replace(aside)
                kept = f"it is kept as {aside.name}"
            except OSError as reason:
                kept = f"it could not be put aside ({reason.strerror}) and will be overwritten"
            self._logger.error(f"the state is not used: {error}; {kept}; starting with no maps")
            return
        names = ", ".join(session.maps) or "no agents"
        self._logger.info(f"{self._path}: took up the maps of {names}")

    def keep(self, session: MergerSession) -> str:
        """Write what a session knows; return why that failed, or an empty string."""
        if self._path is None:
            return ""
        try:
            save_state(self._path, session.state(), self._encoded)
        except MapFileError as error:
            text = f"the state was not saved: {error}"
            if text != self._told:
                self._logger.error(text)
            self._told = text
            return text
        self._told = ""
        return ""


def _file(path: str) -> Path:
    try:
        file = Path(path).expanduser()
        if not stat.S_ISREG(file.stat().st_mode):
            raise ConfigurationError(f"state_file: expected a file, {file} is something else")
    except FileNotFoundError:
        pass
    except (OSError, ValueError, RuntimeError) as error:  # No such user, or no such name at all.
        raise ConfigurationError(f"state_file: {path!r}: {error}") from error
    return file
