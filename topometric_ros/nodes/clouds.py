"""A topometric map's voxels as a PointCloud2 that RViz and Foxglove colour by room."""

from __future__ import annotations

import array
import sys

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.palette import room_colours

_POINT = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("rgb", "u4"), ("label", "i4")])


def room_cloud(topometric_map: TopometricMap, stamp: Time) -> PointCloud2:
    """Return the voxel centres of a map: x, y, z, rgb and label (room id), in its `frame_id`."""
    T_input_level = np.linalg.inv(topometric_map.T_level_input)
    centres = topometric_map.centres() @ T_input_level[:3, :3].T + T_input_level[:3, 3]
    points = np.empty(len(centres), _POINT)
    for axis, name in enumerate("xyz"):
        points[name] = centres[:, axis]
    points["rgb"] = _packed(room_colours(topometric_map.room))
    points["label"] = topometric_map.room
    message = PointCloud2(
        height=1,
        width=len(points),
        fields=[
            PointField(name="x", offset=0, datatype=PointField.FLOAT32, count=1),
            PointField(name="y", offset=4, datatype=PointField.FLOAT32, count=1),
            PointField(name="z", offset=8, datatype=PointField.FLOAT32, count=1),
            # RViz reads the colour's bits under the name of a float.
            PointField(name="rgb", offset=12, datatype=PointField.FLOAT32, count=1),
            PointField(name="label", offset=16, datatype=PointField.INT32, count=1),
        ],
        is_bigendian=sys.byteorder == "big",
        point_step=_POINT.itemsize,
        row_step=_POINT.itemsize * len(points),
        is_dense=True,
    )
    message.header.frame_id = topometric_map.frame_id
    message.header.stamp = stamp
    # An ndarray here would be copied element by element: seconds instead of milliseconds.
    message.data = array.array("B", points.tobytes())
    return message


def _packed(colours: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return (N, 3) colours as (N,) uint32 0x00RRGGBB."""
    red, green, blue = (colours[:, channel].astype(np.uint32) for channel in range(3))
    return np.asarray((red << 16) | (green << 8) | blue, np.uint32)
