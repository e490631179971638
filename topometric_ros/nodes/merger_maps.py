"""The maps that a merger has before anybody publishes one: those of its state file, those of files.

A map of another day is an agent like any other, but for one thing: nobody publishes it, so it never
counts as gone.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from topometric_ros.errors import TopometricError
from topometric_ros.io.map_files import load_map
from topometric_ros.nodes.roster import TOPIC, Roster
from topometric_ros.runtime.merger_session import MergerSession


def recall(session: MergerSession, roster: Roster, now: int) -> None:
    """Put the agents that a session was restored with on the roster, with the maps that it has.

    Parameters
    ----------
    session, roster : what is known, and who is reported
    now : ns; a map that says to be of later counts as of now
    """
    for agent in session.maps:
        source = session.sources.get(agent, agent)
        entry = roster.recall(agent, source)
        entry.newest = session.newest(agent)
        entry.arrived = min(entry.newest.stamp, now)
        entry.file = "" if source.rpartition("/")[2] == TOPIC else source


def read_files(session: MergerSession, roster: Roster, now: int, logger: Any) -> None:
    """Give a session the maps of the listed files; what cannot be used is told and left out."""
    for agent, path in roster.files.items():
        entry = roster.reports[agent]
        try:
            m = dataclasses.replace(load_map(Path(path).expanduser()), agent=agent)
            session.add_map(m, path)
        except TopometricError as error:
            if entry.refuse(str(error)):
                logger.error(f"map of {agent} refused: {error}")
            continue
        entry.newest, entry.arrived, entry.file, entry.refusal = m, now, path, ""
