"""What merging found: alignments between pairs of agents and each agent's place in the world.

Transforms are named `T_target_source` (4 x 4 float64, m): `p_target = T_target_source @ p_source`.
They hold between the agents' *input* frames, the frames that their clouds and TF trees use.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from topometric_ros.topometric_map import TopometricMap

MERGE_SCHEMA = "topometric-merge/1"


class Basis(StrEnum):
    """What a verdict on a pair of agents rests on."""

    MAPS = "maps"
    """The present maps and parameters."""
    OLDER_MAPS = "older maps"
    """Older maps than those held, or none at all: the pair waits for its turn."""
    OLDER_PARAMETERS = "older parameters"
    """The present maps under parameters that have changed since: the pair waits for its turn."""
    OPERATOR = "operator"
    """What somebody has said of the pair, whatever the maps say."""

    @property
    def waits(self) -> bool:
        """Whether the pair is still to be aligned."""
        return self in (Basis.OLDER_MAPS, Basis.OLDER_PARAMETERS)


TOLD_BASIS = {
    Basis.OLDER_MAPS: "the newest maps are not compared yet",
    Basis.OLDER_PARAMETERS: "the maps are not compared under the new parameters yet",
    Basis.OPERATOR: "by hand",
}
"""How a reason ends that does not rest on the present maps and parameters."""


class AlignmentStatus(StrEnum):
    """How a pair of agents stands to each other; `reason` says why in words."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"
    REJECTED = "rejected"
    NONE = "none"
    WITHDRAWN = "withdrawn"


class AgentStatus(StrEnum):
    """Whether an agent's place in the global frame is known."""

    ANCHOR = "anchor"
    ALIGNED = "aligned"
    UNALIGNED = "unaligned"


@dataclass(frozen=True)
class RoomMatch:
    """A pair of rooms, one in each map, held to be the same place; `distance` of descriptors."""

    room_a: int
    room_b: int
    distance: float


@dataclass(frozen=True)
class Alternative:
    """A pose that was considered and how well it scored (`Evidence.value`, no unit)."""

    T_a_b: NDArray[np.float64]
    score: float


@dataclass(frozen=True)
class Alignment:
    """The accepted transform between two agents with its evidence, or why there is none.

    `overlap` is the share of the smaller map's voxels that the other map holds too, `rmse` (m) the
    residual of the registration, `confidence` 0..1, `covariance` (6, 6) over (x, y, z, roll, pitch,
    yaw) of `T_a_b` in m and rad, or None where there is no transform. `inliers` is the share of the
    points that registration found on the other map, None where it was not done here. `basis` is for
    programs; `reason` tells it to people.
    """

    agents: tuple[str, str]
    status: AlignmentStatus
    reason: str
    T_a_b: NDArray[np.float64] | None = None
    alternatives: tuple[Alternative, ...] = ()
    confidence: float = 0.0
    overlap: float = 0.0
    rmse: float = 0.0
    matches: tuple[RoomMatch, ...] = ()
    covariance: NDArray[np.float64] | None = None
    score: float = 0.0
    inliers: float | None = None
    basis: Basis = Basis.MAPS

    @property
    def accepted(self) -> bool:
        """True where `T_a_b` may be used."""
        return self.status is AlignmentStatus.ACCEPTED


@dataclass(frozen=True)
class AgentPlacement:
    """One agent in the result: its group (agents aligned with each other) and its transforms."""

    id: str
    source: str
    status: AgentStatus
    reason: str
    group: int
    T_group_agent: NDArray[np.float64]
    T_global_agent: NDArray[np.float64] | None


@dataclass(frozen=True)
class Change:
    """What one agent's map holds and another saw to be bare: moved furniture, a door.

    `holder` and `witness` are indices of agents; `gone` says that the holder's map is the older
    one and its voxels were dropped. Else they have appeared since or, where `ordered` is false, it
    is not known which map is the newer. `points` (n, 3) float64, m, global level frame.
    """

    holder: int
    witness: int
    gone: bool
    ordered: bool
    points: NDArray[np.float64]


@dataclass(frozen=True)
class GlobalMap:
    """The fused map of the anchor's group, in the global frame.

    `agents` (N,) uint32 says who saw each voxel of `map`: bit i for the i-th agent of the result.
    `rooms_of` has, for the id of every room, which rooms of which agents became it: pairs of an
    agent's index in the result and a room's id in its map.
    """

    map: TopometricMap
    agents: NDArray[np.uint32]
    rooms_of: Mapping[int, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    changes: tuple[Change, ...] = ()


@dataclass(frozen=True)
class Placed:
    """Where the agents stand and why: what merging finds before it fuses the maps."""

    global_frame: str
    agents: tuple[AgentPlacement, ...]
    alignments: tuple[Alignment, ...]
    warnings: tuple[str, ...] = ()
    timings: dict[str, float] = field(default_factory=dict)
    """CPU seconds by stage."""


@dataclass(frozen=True)
class MergeResult:
    """Everything that `merge.json`, the report and the merger's topics are made of."""

    global_frame: str
    agents: tuple[AgentPlacement, ...]
    alignments: tuple[Alignment, ...]
    global_map: GlobalMap
    warnings: tuple[str, ...] = ()
    timings: dict[str, float] = field(default_factory=dict)
    """CPU seconds by stage; not part of what must be the same in every run."""
