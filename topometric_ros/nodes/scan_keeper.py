"""Keeps what an extractor's scans came to in a file, and takes it up again at the start."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from topometric_ros.nodes.kept_file import KeptFile
from topometric_ros.nodes.worker import Pace
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.runtime.scan_state import load_scans, save_scans

_FIRST_S, _LATER_S = 5.0, 60.0
"""Between two writings: little is gathered and fast in the beginning; later a disk must last."""
_SHARE = 0.05
"""Of the time, at most, that writing takes."""


class ScanKeeper(KeptFile):
    """The scans' file of one extractor; an empty path keeps nothing.

    What an earlier session had gathered and a new one does not go on from stays beside the file, as
    `<name>.before`.
    """

    def __init__(self, path: str, logger: Any, **options: float) -> None:
        super().__init__("scans_file", path, "extractor", "what was gathered", logger, **options)
        self._pace = Pace(_SHARE)
        self._every = _FIRST_S
        self._session = ""
        self._kept: tuple[str, int] | None = None

    def restore(self, session: ExtractorSession) -> None:
        """Give a session what the file holds, if there is one."""

        def take_up(path: Path) -> None:
            state = load_scans(path, session.extraction.scans)
            session.take_up(state)
            self._logger.info(f"{path}: took up {state.scans} scans, {state.grid.cells} cells")

        self.read(take_up)
        self._session = session.session

    def keep(self, session: ExtractorSession, at_once: bool = False) -> str:
        """Write what a session has gathered, where it is time; return why that failed, or "".

        A failure is told until writing succeeds, not only when it is tried.
        """
        if self.path is None or not (at_once or self._pace.due()):
            return self._told
        if self._session != session.session and self.path.exists():
            self.put_aside("before")
        self._session = session.session
        state = session.scan_state()
        if state is None or self._kept == (session.session, state.scans):
            return self._told
        with self._pace.step(1.0 / self._every):
            failure = self.write(lambda path: save_scans(path, state))
        self._every = min(2.0 * self._every, _LATER_S)
        self._kept = None if failure else (session.session, state.scans)
        return failure
