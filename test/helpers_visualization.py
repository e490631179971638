"""Maps and merge results with the demo's true rooms, for the pictures and the report."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from test.helpers import moved
from topometric_ros.alignment import (
    AgentPlacement,
    AgentStatus,
    Alignment,
    AlignmentStatus,
    Alternative,
    GlobalMap,
    MergeResult,
    RoomMatch,
)
from topometric_ros.extraction.layers import LayersConfig, storey_layers
from topometric_ros.simulation.demo import ROOMS_WALKED, DemoConfig, record_agent
from topometric_ros.simulation.office import office
from topometric_ros.simulation.scanner import Scanner
from topometric_ros.topometric_map import NO_ROOM, Passage, Room, Storey, TopometricMap
from topometric_ros.voxels.grid import surface_offsets, thin, voxelise

VOXEL = 0.1


@lru_cache(maxsize=1)
def demo_walks() -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return {agent: (points (n, 3) float64, m, building frame; T_map_building)}."""
    building, config = office(), DemoConfig()
    scanner = Scanner(building, config.lidar)
    walks = {}
    for name in ROOMS_WALKED:
        agent = record_agent(name, building, scanner, config)
        T_building_map = np.linalg.inv(agent.T_map_building)
        poses = [T_building_map @ T @ agent.T_base_lidar for T in agent.T_map_base]
        parts = [moved(s.astype(float), T) for s, T in zip(agent.scans, poses, strict=True)]
        walks[name] = np.concatenate(parts), agent.T_map_building
    return walks


def true_map(
    points: NDArray[np.float64],
    T_map_building: NDArray[np.float64],
    agent: str,
    walked: tuple[int, ...],
) -> TopometricMap:
    """Return the map that an extractor would make if it knew the rooms.

    `points` (n, 3) float64, m, building frame; the voxels are in the agent's map frame.
    """
    building = office()
    floor_z = float(T_map_building[2, 3])
    origin = np.array([0.0, 0.0, floor_z])
    in_map = moved(points, T_map_building)
    grid, cell = voxelise(in_map, VOXEL, origin)
    centres = moved(grid.centres(), np.linalg.inv(T_map_building))
    label = np.full(len(grid), NO_ROOM, dtype=np.int32)
    for area in building.areas:
        x0, y0, x1, y1 = area.bounds
        if area.room in walked:
            x, y = centres[:, 0], centres[:, 1]
            label[(x >= x0) & (x < x1) & (y >= y0) & (y < y1)] = area.room
    (layers,) = storey_layers(thin(in_map, 0.05), [floor_z], LayersConfig())
    passages = _passages(T_map_building, walked)
    joined = {room for passage in passages for room in passage.rooms}
    rooms = tuple(_room(r, grid.centres()[label == r], r in joined) for r in sorted(walked))
    return TopometricMap(
        agent=agent,
        session="test",
        sequence=1,
        frame_id=f"{agent}/map",
        stamp=0,
        voxel_size=VOXEL,
        origin=(0.0, 0.0, floor_z),
        voxels=grid.coords,
        offsets=surface_offsets(in_map, grid, cell),
        room=label,
        navigable=np.empty((0, 3), np.int32),
        viewpoints=np.empty((0, 3), np.float32),
        rooms=rooms,
        passages=passages,
        storeys=(Storey(0, floor_z, floor_z + 2.7, layers),),
    )


def _room(room: int, places: NDArray[np.float64], joined: bool) -> Room:
    columns = np.unique(np.round(places[:, :2] / VOXEL), axis=0)
    return Room(
        id=room,
        storey=0,
        centroid=tuple(places.mean(axis=0).tolist()),
        bounds=(tuple(places.min(axis=0).tolist()), tuple(places.max(axis=0).tolist())),
        voxels=len(places),
        area=len(columns) * VOXEL**2,
        isolated=not joined,
    )


def _passages(T_map_building: NDArray[np.float64], walked: tuple[int, ...]) -> tuple[Passage, ...]:
    building = office()
    passages = []
    for door in (o for o in building.openings if o.kind == "door"):
        x, y = door.position
        rooms = {building.room_at(x + dx, y + dy) for dx in (-0.3, 0.3) for dy in (-0.3, 0.3)}
        if rooms <= set(walked) and len(rooms) == 2:
            place = moved(np.array([[x, y, 0.0]]), T_map_building)[0]
            passages.append(Passage(tuple(sorted(rooms)), tuple(place.tolist()), door.width))
    return tuple(passages)


@lru_cache(maxsize=1)
def demo_maps() -> tuple[TopometricMap, ...]:
    """Return the true maps of the demo's two agents."""
    return tuple(
        true_map(points, T, name, (0, *ROOMS_WALKED[name]))
        for name, (points, T) in demo_walks().items()
    )


def demo_truth() -> NDArray[np.float64]:
    """Return T_robot1_robot2 of the demo."""
    (_, first), (_, second) = demo_walks().values()
    return first @ np.linalg.inv(second)


@lru_cache(maxsize=1)
def merged_result() -> MergeResult:
    """Return what a perfect merger would say of the demo."""
    walks = demo_walks()
    (a, T_a), (b, _) = walks.values()
    walked = tuple(sorted({0, *ROOMS_WALKED["robot1"], *ROOMS_WALKED["robot2"]}))
    fused = true_map(np.concatenate([a, b]), T_a, "global", walked)
    seen = np.zeros(len(fused.voxels), dtype=np.uint32)
    for k, points in enumerate((a, b)):
        grid, _ = voxelise(moved(points, T_a), VOXEL, np.asarray(fused.origin))
        keys = {tuple(c) for c in grid.coords.tolist()}
        held = np.array([tuple(c) in keys for c in fused.voxels.tolist()])
        seen |= (held.astype(np.uint32) << np.uint32(k)).astype(np.uint32)
    truth = demo_truth()
    shared = sorted(set(ROOMS_WALKED["robot1"]) & set(ROOMS_WALKED["robot2"]) | {0})
    alignment = Alignment(
        agents=("robot1", "robot2"),
        status=AlignmentStatus.ACCEPTED,
        reason="the best pose scores 812, 640 more than the next distinct one; "
        "71 m² of floor and 58 m of wall agree, 0.2 % of the walls conflict",
        T_a_b=truth,
        alternatives=(Alternative(_elsewhere() @ truth, 172.4),),
        confidence=0.97,
        overlap=0.52,
        rmse=0.011,
        matches=tuple(RoomMatch(r, r, 0.1 + 0.05 * r) for r in shared),
        covariance=np.eye(6) * 1e-4,
        score=812.0,
    )
    return MergeResult(
        global_frame="map",
        agents=(
            _placement("robot1", AgentStatus.ANCHOR, "the first agent", 0, np.eye(4), True),
            _placement("robot2", AgentStatus.ALIGNED, "aligned with robot1", 0, truth, True),
        ),
        alignments=(alignment,),
        global_map=GlobalMap(fused, seen),
    )


def unmerged_result(status: AlignmentStatus = AlignmentStatus.AMBIGUOUS) -> MergeResult:
    """Return what a merger says that cannot decide between two poses."""
    first, _ = demo_maps()
    truth = demo_truth()
    alignment = Alignment(
        agents=("robot1", "robot2"),
        status=status,
        reason="two poses fit nearly as well: scores 310 and 262, and 150 between them is needed",
        alternatives=(Alternative(truth, 310.2), Alternative(_elsewhere() @ truth, 262.0)),
    )
    return MergeResult(
        global_frame="map",
        agents=(
            _placement("robot1", AgentStatus.ANCHOR, "the first agent", 0, np.eye(4), True),
            _placement(
                "robot2", AgentStatus.UNALIGNED, "no alignment <accepted>", 1, np.eye(4), False
            ),
        ),
        alignments=(alignment,),
        global_map=GlobalMap(first, np.ones(len(first.voxels), np.uint32)),
        warnings=("robot2: the cloud is tilted by 2.1°; it was levelled",),
    )


def _elsewhere() -> NDArray[np.float64]:
    T = np.diag([-1.0, -1.0, 1.0, 1.0])
    T[:2, 3] = 9.0, 4.0
    return T


def _placement(
    name: str,
    status: AgentStatus,
    reason: str,
    group: int,
    T: NDArray[np.float64],
    placed: bool,
) -> AgentPlacement:
    return AgentPlacement(
        name, f"bags/demo:/{name}/scan_cloud", status, reason, group, T, T if placed else None
    )
