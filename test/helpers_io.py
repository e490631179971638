"""Small maps, clouds and messages that the tests of files, bags and sessions share."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from topometric_ros.topometric_map import (
    NO_ROOM,
    Descriptors,
    Passage,
    Room,
    Storey,
    StoreyLayers,
    TopometricMap,
)
from topometric_ros.voxels.grid import in_morton_order


def random_map(seed: int = 0, agent: str = "robot1", voxels: int = 500) -> TopometricMap:
    """Return a map of two rooms with every field filled, from seeded noise."""
    rng = np.random.default_rng(seed)
    coords = in_morton_order(rng.integers(-40, 40, (voxels, 3)))
    n = len(coords)
    room = np.where(coords[:, 0] < 0, 3, 7).astype(np.int32)
    room[rng.random(n) < 0.1] = NO_ROOM
    shape = (13, 9)
    masks = {name: rng.random(shape) < 0.4 for name in ("wall", "furniture", "free", "bare")}
    low, high = (-4.0, -4.0, -4.0), (4.0, 4.0, 1 / 3)
    return TopometricMap(
        agent=agent,
        session="session-1",
        sequence=4,
        frame_id=f"{agent}/map",
        stamp=1_767_225_600_123_456_789,
        voxel_size=0.1,
        origin=(0.05, -0.15, 1 / 3),
        voxels=coords,
        offsets=rng.integers(-2, 2, (n, 3)).astype(np.int8),
        room=room,
        navigable=in_morton_order(rng.integers(-40, 40, (50, 3))),
        viewpoints=rng.normal(size=(6, 3)).astype(np.float32),
        rooms=(
            Room(3, 0, (-2.0, 0.1, 0.7), (low, high), int((room == 3).sum()), 12.34, False),
            Room(
                *(7, 0, (2.0, 0.2, 0.9), (low, high), int((room == 7).sum()), 1 / 7, False),
                *((1.5, 0.3, 1 / 3), 11.1, 28.9, 2 / 3, 1.7, "corridor", 0.8),
            ),
        ),
        passages=(Passage((3, 7), (0.0, 0.1, 0.2), 0.9, 1.95, "door", 1 / 3),),
        storeys=(
            Storey(0, 0.01, None, StoreyLayers(0.1, (-4.0, 1 / 9), **masks)),
            Storey(1, 2.9, 5.3, StoreyLayers(0.1, (-4.0, 1 / 9), **masks)),
        ),
        descriptors=(
            Descriptors("engineered", 1, rng.normal(size=(2, 5)).astype(np.float32)),
            Descriptors("spectral", 2, rng.normal(size=(2, 3)).astype(np.float32)),
        ),
        T_level_input=np.array([[0, -1, 0, 1 / 3], [1, 0, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1.0]]),
        warnings=("3 of 10 points were not finite and were dropped",),
    )


def assert_same_map(a: TopometricMap, b: TopometricMap) -> None:
    """Assert that two maps are equal in every bit."""
    for name in ("voxels", "offsets", "room", "navigable", "viewpoints", "T_level_input"):
        left, right = getattr(a, name), getattr(b, name)
        assert left.dtype == right.dtype, name
        np.testing.assert_array_equal(left, right, err_msg=name)
    for name in (
        *("schema", "agent", "session", "sequence", "frame_id", "stamp", "voxel_size", "origin"),
        *("rooms", "passages", "warnings"),
    ):
        assert getattr(a, name) == getattr(b, name), name
    assert len(a.storeys) == len(b.storeys)
    for one, two in zip(a.storeys, b.storeys, strict=True):
        assert (one.id, one.floor_z, one.ceiling_z) == (two.id, two.floor_z, two.ceiling_z)
        assert (one.layers.cell, one.layers.origin) == (two.layers.cell, two.layers.origin)
        for name in ("wall", "furniture", "free", "bare"):
            np.testing.assert_array_equal(getattr(one.layers, name), getattr(two.layers, name))
    assert [(d.name, d.version) for d in a.descriptors] == [
        (d.name, d.version) for d in b.descriptors
    ]
    for left_d, right_d in zip(a.descriptors, b.descriptors, strict=True):
        np.testing.assert_array_equal(left_d.values, right_d.values)


def cloud_fields(dtype: str = "f4", order: str = "<") -> tuple[np.dtype, list[SimpleNamespace]]:
    """Return a point's numpy layout (x, y, z, intensity) and the same as PointField objects."""
    layout = np.dtype([(name, order + dtype) for name in ("x", "y", "z", "intensity")])
    kind = {"f4": 7, "f8": 8}[dtype]
    size = layout.itemsize // 4
    fields = [
        SimpleNamespace(name=name, offset=i * size, datatype=kind, count=1)
        for i, name in enumerate(layout.names or ())
    ]
    return layout, fields


def cloud_message(
    points: NDArray[np.float64], dtype: str = "f4", order: str = "<"
) -> SimpleNamespace:
    """Return points (N, 3) as an unorganised PointCloud2 with an intensity field."""
    layout, fields = cloud_fields(dtype, order)
    table = np.zeros(len(points), layout)
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    return SimpleNamespace(
        height=1,
        width=len(points),
        point_step=layout.itemsize,
        row_step=layout.itemsize * len(points),
        is_bigendian=order == ">",
        fields=fields,
        data=table.tobytes(),
    )
