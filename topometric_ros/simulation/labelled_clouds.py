"""Clouds whose points carry their room: S3DIS, the Collaborative SLAM data set, labelled PLY.

The rooms' outlines and the links between them are proposed from the points; a person corrects
them in the sidecar files.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.cloud_rooms import rooms_and_links
from topometric_ros.simulation.labelled import LabelledBuilding

THINNED = 0.02
"""At most one point of a room is kept in each cube of this edge, m."""
_REACH = 0.2
"""How far a map's point may lie from the annotated point that it takes its room from, m."""
_LABELS = ("label", "room")
_NOTES = "Annotations"
_MESHES = "meshes"


def load_s3dis(path: Path) -> LabelledBuilding:
    """Return an area of S3DIS: a folder for each room, `<room>/<room>.txt` with x y z r g b.

    The folders' names are the rooms': `hallway_1` is a corridor. `Annotations` are not read. One
    file of the release has another name than its folder, Area_6/copyRoom_1/copy_Room_1.txt.

    Raises
    ------
    BuildingError
        There is no room, a room's file is missing or damaged, or the rooms are in frames of
        their own.
    """
    if any(part.endswith("Aligned_Version") for part in path.resolve().parts):
        raise BuildingError(
            f"{path}: each room of the aligned version is turned by itself; expected the areas of "
            "Stanford3dDataset_v1.2"
        )
    folders = sorted(folder for folder in path.iterdir() if folder.is_dir())
    rooms = {folder.name: sorted(folder.glob("*.txt")) for folder in folders}
    rooms = {
        name: files for name, files in rooms.items() if files or (path / name / _NOTES).is_dir()
    }
    if not rooms:
        raise BuildingError(f"{path}: no room, expected files <room>/<room>.txt")
    clouds = [_thinned(_read_text(_room_file(path / name, rooms[name]))) for name in rooms]
    labels = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    return _building(path.name, np.concatenate(clouds), labels, list(rooms))


def _room_file(folder: Path, files: list[Path]) -> Path:
    """Return the file with a room's points: of the folder's name, or the only one."""
    named = folder / f"{folder.name}.txt"
    if named in files:
        return named
    if len(files) != 1:
        raise BuildingError(f"{named}: no such file, and {len(files)} others in its place")
    return files[0]


def load_ply(path: Path) -> LabelledBuilding:
    """Return the building of a PLY cloud with a vertex property `label` or `room`; -1: no room.

    Raises
    ------
    BuildingError
        The file is no cloud or has no labels.
    """
    points, labels = read_labelled_ply(path)
    if labels is None:
        raise BuildingError(f"{path}: expected a vertex property {' or '.join(_LABELS)}")
    return _of_labels(path.stem, points, labels)


def load_cslamd(path: Path) -> LabelledBuilding:
    """Return a scene of the Collaborative SLAM data set: all of its maps together (`cslamd_maps`).

    Raises
    ------
    BuildingError
        A file is damaged, no map has a transform, or there are no labels.
    """
    clouds, labels = zip(*cslamd_maps(path), strict=True)
    return _of_labels(path.name, np.concatenate(clouds), np.concatenate(labels))


def cslamd_maps(path: Path) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Return the points (N, 3), m, building frame, and labels (N,) of every map of a scene.

    The maps are `meshes/<sequence>.ply` as the release has them, in one frame already, and
    `meshes.txt` is T_building_meshes, sixteen numbers, row by row; without it the frame is the
    building's. Or every `<map>.ply` has its own T_building_map in `<map>.txt`. A labelled PLY that
    is neither is the scene's annotation, in the building frame: maps without labels of their own
    take those of its nearest points.

    Raises
    ------
    BuildingError
        A file is damaged, no map has a transform, or there are no labels.
    """
    annotation: tuple[NDArray, NDArray] | None = None
    clouds, rooms = [], []
    shared = path / f"{_MESHES}.txt"
    T_building_meshes = read_transform(shared) if shared.exists() else np.eye(4)
    for file in [*sorted(path.glob("*.ply")), *sorted(path.glob(f"{_MESHES}/*.ply"))]:
        points, labels = read_labelled_ply(file)
        truth = file.with_suffix(".txt")
        if file.parent != path or truth.exists():
            T = read_transform(truth) if file.parent == path else T_building_meshes
            clouds.append(points @ T[:3, :3].T + T[:3, 3])
            rooms.append(labels)
        elif labels is not None:
            annotation = points, labels
    if not clouds:
        raise BuildingError(
            f"{path}: no meshes/<sequence>.ply, nor a <map>.ply with its transform in <map>.txt"
        )
    if annotation is None and any(labels is None for labels in rooms):
        raise BuildingError(f"{path}: no labels; expected a PLY with them in the building frame")
    given = [
        _labels_of_nearest(points, annotation) if labels is None else labels
        for points, labels in zip(clouds, rooms, strict=True)
    ]
    return list(zip(clouds, given, strict=True))


def read_labelled_ply(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64] | None]:
    """Return the points (N, 3) and labels (N,), if any, of a PLY file.

    Raises
    ------
    BuildingError
        The file cannot be read.
    """
    import open3d as o3d

    if not path.exists():
        raise BuildingError(f"{path}: no such file")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.t.io.read_point_cloud(path)
    if "positions" not in cloud.point or len(cloud.point["positions"]) == 0:
        raise BuildingError(f"{path}: not a PLY cloud, or an empty one")
    points = cloud.point["positions"].numpy().astype(np.float64)
    finite = np.isfinite(points).all(axis=1)
    name = next((name for name in _LABELS if name in cloud.point), None)
    if name is None:
        return points[finite], None
    return points[finite], cloud.point[name].numpy().reshape(-1).astype(np.int64)[finite]


def read_transform(path: Path) -> NDArray[np.float64]:
    """Return the rigid transform (4, 4) of a text file with sixteen numbers, row by row.

    Raises
    ------
    BuildingError
        The file has other numbers.
    """
    try:
        T = np.array(path.read_text(encoding="utf-8").split(), dtype=np.float64)
    except (OSError, ValueError) as error:
        raise BuildingError(f"{path}: expected sixteen numbers: {error}") from error
    if T.size != 16:
        raise BuildingError(f"{path}: expected sixteen numbers, got {T.size}")
    T = T.reshape(4, 4)
    if not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3):
        raise BuildingError(f"{path}: the transform's rotation is none")
    return T


def _of_labels(
    name: str, points: NDArray[np.float64], labels: NDArray[np.int64]
) -> LabelledBuilding:
    """Number the labels from 0 and name the rooms after them."""
    values = np.unique(labels[labels >= 0])
    if not len(values):
        raise BuildingError(f"{name}: all {len(labels)} labels are negative")
    ids = np.where(labels >= 0, np.searchsorted(values, labels), -1)
    return _building(name, points, ids, [f"room {value}" for value in values])


def _building(
    name: str, points: NDArray[np.float64], labels: NDArray[np.int64], names: list[str]
) -> LabelledBuilding:
    rooms, links = rooms_and_links(points, labels, names)
    return LabelledBuilding(
        name,
        np.empty((0, 3)),
        np.empty((0, 3), dtype=np.int32),
        rooms,
        links,
        points=points,
        labels=labels.astype(np.int32),
    )


def _labels_of_nearest(
    points: NDArray[np.float64], annotation: tuple[NDArray, NDArray] | None
) -> NDArray[np.int64]:
    from scipy.spatial import cKDTree

    assert annotation is not None
    distance, nearest = cKDTree(annotation[0]).query(points, distance_upper_bound=_REACH)
    labels = np.full(len(points), -1, dtype=np.int64)
    labels[np.isfinite(distance)] = annotation[1][nearest[np.isfinite(distance)]]
    return labels


def _thinned(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first point in each cube, in the order of the cubes."""
    _, first = np.unique(np.floor(points / THINNED).astype(np.int64), axis=0, return_index=True)
    return points[first]


def _read_text(path: Path) -> NDArray[np.float64]:
    """Return the first three columns of a text file.

    A room of the public release has a line with a stray byte; lines that hold anything but
    numbers are left out where the file cannot be read as it is.
    """
    try:
        return np.loadtxt(path, usecols=(0, 1, 2), ndmin=2, comments=None, encoding="latin-1")
    except ValueError:
        text = path.read_text(encoding="latin-1")
    rows = []
    for line in text.splitlines():
        try:
            rows.append([float(word) for word in line.split()[:3]])
        except ValueError:
            continue
    complete = [row for row in rows if len(row) == 3]
    if not complete:
        raise BuildingError(f"{path}: no line has three numbers")
    return np.array(complete)
