"""A file in which a node keeps what must survive its end, of one node alone and never half written.

A file that cannot be read is put aside, not overwritten, and the node starts with nothing: robots
wait for it. A file that cannot be written is told once and tried again the next time. A lock beside
it, which ends with the process however that ends, keeps it to one node.
"""

from __future__ import annotations

import contextlib
import fcntl
import glob
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, TypeVar

from topometric_ros.errors import ConfigurationError, TopometricError
from topometric_ros.io.map_format import MapFileError

_PATIENCE_S = 5.0
"""How long a node that is told to end may take, which the next one waits for."""

ContentT = TypeVar("ContentT")


class KeptFile:
    """What a parameter of a node names; an empty path keeps nothing.

    Parameters
    ----------
    parameter : the parameter's name
    path : the file
    owner : what kind of node keeps it, such as merger
    content : what it holds, in words
    logger : the node's
    patience : how long (s) another node that has the file is waited for

    Raises
    ------
    ConfigurationError
        The path is that of a folder, a device or a pipe, which must not be put aside or replaced,
        of another node that is running, or in a folder that is not there.
    """

    def __init__(
        self,
        parameter: str,
        path: str,
        owner: str,
        content: str,
        logger: Any,
        patience: float = _PATIENCE_S,
    ) -> None:
        self._parameter, self._owner, self._content = parameter, owner, content
        self._logger = logger
        self._told = ""
        self._lock: IO[bytes] | None = None
        self.path = self._file(path) if path else None
        """None where nothing is kept."""
        if self.path is not None:
            self._claim(self.path, patience)

    def _claim(self, path: Path, patience: float) -> None:
        """Let no other node have the file, and take away what killed ones have left half done."""
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
                        f"{self._parameter}: {path} is kept by another {self._owner} that is "
                        "running; each needs a file of its own"
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

    def read(self, take_up: Callable[[Path], ContentT]) -> ContentT | None:
        """Return what a file that is there comes to, None where nothing can be taken up."""
        if self.path is None or not self.path.exists():
            return None
        try:
            return take_up(self.path)
        except TopometricError as error:
            kept = self.put_aside("damaged")
            self._logger.error(f"{self._content} is not used: {error}; {kept}; starting with none")
            return None

    def put_aside(self, why: str) -> str:
        """Give the file another name; return in words what became of it."""
        assert self.path is not None
        aside = self.path.with_name(f"{self.path.name}.{why}")
        try:
            self.path.replace(aside)
        except OSError as reason:
            return f"it could not be put aside ({reason.strerror}) and will be overwritten"
        return f"it is kept as {aside.name}"

    def write(self, save: Callable[[Path], None]) -> str:
        """Write the file; return why that failed, or an empty string."""
        if self.path is None:
            return ""
        try:
            save(self.path)
        except MapFileError as error:
            text = f"{self._content} was not saved: {error}"
            if text != self._told:
                self._logger.error(text)
            self._told = text
            return text
        self._told = ""
        return ""

    def _file(self, path: str) -> Path:
        name = self._parameter
        try:
            file = Path(path).expanduser()
            if not stat.S_ISREG(file.stat().st_mode):
                raise ConfigurationError(f"{name}: expected a file, {file} is something else")
        except FileNotFoundError:
            if not file.parent.is_dir():
                raise ConfigurationError(f"{name}: no folder {file.parent}") from None
        except (OSError, ValueError, RuntimeError) as error:  # No such user, or no name at all.
            raise ConfigurationError(f"{name}: {path!r}: {error}") from error
        return file
