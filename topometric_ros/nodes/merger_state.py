"""Keeps the merger's memory in a file, and takes it up again at the start.

A file that cannot be read is put aside, not overwritten, and the merger starts with nothing: robots
wait for it. A file that cannot be written is told once and tried again after the next merge. One
file is of one merger: a lock beside it, which ends with the process however that ends, says so.
"""

from __future__ import annotations

import contextlib
import fcntl
import glob
import stat
import time
from pathlib import Path
from typing import IO, Any

from topometric_ros.errors import ConfigurationError
from topometric_ros.io.map_format import MapFileError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import EncodedMaps, load_state, save_state

_PATIENCE_S = 5.0
"""How long a merger that is told to end may take, which the next one waits for."""


class StateKeeper:
    """The state file of one merger; an empty path keeps nothing.

    Parameters
    ----------
    path : the file
    logger : the node's
    patience : how long (s) another merger that has the file is waited for

    Raises
    ------
    ConfigurationError
        The path is that of a folder, a device or a pipe, which must not be put aside or replaced,
        of another merger that is running, or in a folder that is not there.
    """

    def __init__(self, path: str, logger: Any, patience: float = _PATIENCE_S) -> None:
        self._path = _file(path) if path else None
        self._logger = logger
        self._told = ""
        self._encoded = EncodedMaps()
        self._lock: IO[bytes] | None = None
        if self._path is not None:
            self._claim(self._path, patience)

    def _claim(self, path: Path, patience: float) -> None:
        """Let no other merger have the file, and take away what killed ones have left half done."""
        try:
            self._lock = path.with_name(f".{path.name}.lock").open("wb")
        except OSError as error:  # Nobody else can overwrite anything there either.
            self._logger.error(f"{path}: nothing can be kept there: {error.strerror}")
            return
        until = time.monotonic() + patience
        while True:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > until:
                    self.close()
                    raise ConfigurationError(
                        f"state_file: {path} is kept by another merger that is running; "
                        "each needs a file of its own"
                    ) from None
                time.sleep(0.1)
            except OSError as error:
                self._logger.warning(f"{path}: cannot be locked ({error.strerror})")
                break
        for left in path.parent.glob(f".{glob.escape(path.name)}.*.partial"):
            with contextlib.suppress(OSError):
                left.unlink()

    def close(self) -> None:
        """Leave the file to others."""
        if self._lock is not None:
            self._lock.close()
        self._lock = None

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
        if not file.parent.is_dir():
            raise ConfigurationError(f"state_file: no folder {file.parent}") from None
    except (OSError, ValueError, RuntimeError) as error:  # No such user, or no such name at all.
        raise ConfigurationError(f"state_file: {path!r}: {error}") from error
    return file
