"""Keeps the merger's memory in a file, and takes it up again at the start."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from topometric_ros.nodes.kept_file import KeptFile
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import EncodedMaps, load_state, save_state


class StateKeeper(KeptFile):
    """The state file of one merger; an empty path keeps nothing."""

    def __init__(self, path: str, logger: Any, **options: float) -> None:
        super().__init__("state_file", path, "merger", "the state", logger, **options)
        self._encoded = EncodedMaps()

    def restore(self, session: MergerSession) -> None:
        """Give a session what the file holds, if there is one."""
        if self.path is not None and not self.path.exists():
            self._logger.info(f"{self.path}: no state yet, it is written after the first merge")

        def take_up(path: Path) -> None:
            session.restore(load_state(path))
            names = ", ".join(session.maps) or "no agents"
            self._logger.info(f"{path}: took up the maps of {names}")

        self.read(take_up)

    def keep(self, session: MergerSession) -> str:
        """Write what a session knows; return why that failed, or an empty string."""
        return self.write(lambda path: save_state(path, session.state(), self._encoded))
