"""A map's voxels as a PointCloud2 that RViz and Foxglove colour by room, of any message library."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.runtime.message_codec import byte_field, header
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.palette import room_colours

_FLOAT32, _INT32, _UINT32 = 7, 5, 6
_LAYOUT = (
    *(("x", "f4", _FLOAT32), ("y", "f4", _FLOAT32), ("z", "f4", _FLOAT32)),
    ("rgb", "u4", _FLOAT32),  # RViz reads the colour's bits under the name of a float.
    ("label", "i4", _INT32),
)
_AGENTS = ("agents", "u4", _UINT32)


def map_cloud(
    m: TopometricMap,
    classes: Any,
    stamp: int,
    observed_by: NDArray[np.uint32] | None = None,
) -> Any:
    """Return the voxel centres of a map: x, y, z, rgb and label (room id), in its `frame_id`.

    With `observed_by` (N,) the field `agents` is added: the bit mask of who saw the voxel.
    """
    layout = _LAYOUT if observed_by is None else (*_LAYOUT, _AGENTS)
    points = np.empty(len(m.voxels), [(name, kind) for name, kind, _ in layout])
    T_input_level = np.linalg.inv(m.T_level_input)
    centres = m.centres() @ T_input_level[:3, :3].T + T_input_level[:3, 3]
    for axis, name in enumerate("xyz"):
        points[name] = centres[:, axis]
    red, green, blue = room_colours(m.room).astype(np.uint32).T
    points["rgb"] = (red << 16) | (green << 8) | blue
    points["label"] = m.room
    if observed_by is not None:
        points["agents"] = observed_by
    return classes.PointCloud2(
        header=header(classes, m.frame_id, stamp),
        height=1,
        width=len(points),
        fields=[
            classes.PointField(name=name, offset=4 * i, datatype=datatype, count=1)
            for i, (name, _, datatype) in enumerate(layout)
        ],
        is_bigendian=sys.byteorder == "big",
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=byte_field(classes.PointCloud2, points.tobytes()),
        is_dense=True,
    )
