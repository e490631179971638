"""Small bags that the tests write: clouds and transforms of a box-shaped flat."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from test.helpers import box_room
from topometric_ros.io.bag_messages import CLOUD_TYPE, TRANSFORM_TYPE, message_classes
from topometric_ros.io.bag_writer import BagWriter
from topometric_ros.runtime.message_codec import byte_field, header

START = 1_767_225_600_000_000_000
SECOND = 1_000_000_000


def flat() -> NDArray[np.float64]:
    """Return the points of three rooms in a row that differ in size, with doors between them."""
    first = box_room((0, 0, 0), (4, 5, 2.6), (("x+", 2.0),), step=0.06)
    second = box_room((4, 0, 0), (6, 4, 2.6), (("x-", 2.0), ("x+", 1.0)), step=0.06)
    third = box_room((10, 0, 0), (3, 7, 2.6), (("x-", 1.0),), step=0.06)
    return np.concatenate([first, second, third])


def cloud(points: NDArray[np.float64], frame: str, stamp: int, **changes: Any) -> Any:
    """Return points (N, 3) as a PointCloud2 of rosbags' classes; `changes` replace its fields."""
    classes = message_classes()
    raw = np.ascontiguousarray(points, "<f4").tobytes()
    fields = {
        "header": header(classes, frame, stamp),
        "height": 1,
        "width": len(points),
        "fields": [
            classes.PointField(name=axis, offset=4 * i, datatype=7, count=1)
            for i, axis in enumerate("xyz")
        ],
        "is_bigendian": False,
        "point_step": 12,
        "row_step": 12 * len(points),
        "data": byte_field(classes.PointCloud2, raw),
        "is_dense": True,
    }
    return classes.PointCloud2(**{**fields, **changes})


def transforms(*entries: tuple[str, str, NDArray[np.float64]], stamp: int) -> Any:
    """Return (parent, child, T_parent_child) entries as a TFMessage of rosbags' classes."""
    classes = message_classes()
    stamped = []
    for parent, child, T in entries:
        x, y, z = T[:3, 3].tolist()
        qx, qy, qz, qw = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        stamped.append(
            classes.TransformStamped(
                header=header(classes, parent, stamp),
                child_frame_id=child,
                transform=classes.Transform(
                    translation=classes.Vector3(x=x, y=y, z=z),
                    rotation=classes.Quaternion(x=qx, y=qy, z=qz, w=qw),
                ),
            )
        )
    return classes.TFMessage(transforms=stamped)


def write_map_bag(path: Path, clouds: dict[str, NDArray[np.float64]], **changes: Any) -> Path:
    """Write a bag with one map cloud for each topic, in frame `map`; return its directory."""
    with BagWriter(path) as bag:
        for topic in clouds:
            bag.add_topic(topic, CLOUD_TYPE, latched=True)
        for i, (topic, points) in enumerate(clouds.items()):
            stamp = START + i * SECOND
            bag.write(topic, stamp + 5, cloud(points, "map", stamp, **changes))
    return path


def write_scan_bag(path: Path, points: NDArray[np.float64], namespace: str = "") -> Path:
    """Write a bag of five scans of `points` from moving sensors, with /tf; return its directory."""
    topic = f"{namespace}/scan_cloud"
    mount = np.eye(4)
    mount[2, 3] = 1.2
    with BagWriter(path) as bag:
        bag.add_topic("/tf_static", TRANSFORM_TYPE, latched=True)
        bag.add_topic("/tf", TRANSFORM_TYPE)
        bag.add_topic(topic, CLOUD_TYPE)
        static = transforms(("base_link", "lidar", mount), stamp=START)
        bag.write("/tf_static", START, static)
        for i in range(5):
            stamp = START + i * SECOND
            base = np.eye(4)
            base[:3, :3] = Rotation.from_euler("z", 0.3 * i).as_matrix()
            base[:3, 3] = (1.0 + i, 2.0, 0.0)
            moving = transforms(
                ("map", "odom", np.eye(4)), ("odom", "base_link", base), stamp=stamp
            )
            T_sensor_map = np.linalg.inv(base @ mount)
            part = points[i::5] @ T_sensor_map[:3, :3].T + T_sensor_map[:3, 3]
            # The scan is received before the transform of its moment.
            bag.write(topic, stamp + 1, cloud(part, "lidar", stamp))
            bag.write("/tf", stamp + 2, moving)
    return path
