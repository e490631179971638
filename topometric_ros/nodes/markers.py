"""A topometric map as RViz and Foxglove markers: rooms, their names, passages and graph edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from topometric_ros.topometric_map import Room, TopometricMap
from topometric_ros.voxels.palette import room_colours

_ROOM_DIAMETER = 0.4
_TEXT_HEIGHT = 0.35
_EDGE_WIDTH = 0.06
_PASSAGE_EDGE = 0.25

Vector = Sequence[float] | NDArray[np.float64]


def map_markers(topometric_map: TopometricMap, stamp: Time) -> MarkerArray:
    """Return the markers of a map in its `frame_id`.

    Parameters
    ----------
    topometric_map
        Partial or global map.
    stamp
        Stamp of every marker.

    Returns
    -------
    visualization_msgs.msg.MarkerArray
        A marker that deletes what earlier arrays drew, then spheres and names for rooms, cubes for
        passages and lines from each passage to its two rooms.
    """
    sketch = _Sketch(topometric_map, stamp)
    colours = room_colours([room.id for room in topometric_map.rooms])
    array = MarkerArray(markers=[sketch.clear()])
    for room, colour in zip(topometric_map.rooms, colours, strict=True):
        array.markers.append(sketch.room(room, colour))
        array.markers.append(sketch.name(room))
    if topometric_map.passages:
        array.markers += [sketch.passages(), sketch.edges()]
    return array


class _Sketch:
    """Makes markers of one map: positions go from its level frame to its input frame."""

    def __init__(self, topometric_map: TopometricMap, stamp: Time) -> None:
        self._map = topometric_map
        self._stamp = stamp
        self._T_input_level = np.linalg.inv(topometric_map.T_level_input)

    def point(self, position: Vector) -> Point:
        x, y, z = (self._T_input_level[:3, :3] @ position + self._T_input_level[:3, 3]).tolist()
        return Point(x=x, y=y, z=z)

    def clear(self) -> Marker:
        marker = Marker(action=Marker.DELETEALL)
        marker.header.frame_id = self._map.frame_id
        marker.header.stamp = self._stamp
        return marker

    def marker(self, namespace: str, identifier: int, kind: int) -> Marker:
        marker = Marker(ns=namespace, id=identifier, type=kind, action=Marker.ADD)
        marker.header.frame_id = self._map.frame_id
        marker.header.stamp = self._stamp
        marker.pose = Pose(orientation=Quaternion(w=1.0))
        marker.color = _colour((255, 255, 255))
        return marker

    def room(self, room: Room, colour: Sequence[int] | NDArray[np.uint8]) -> Marker:
        marker = self.marker("rooms", room.id, Marker.SPHERE)
        marker.pose.position = self.point(room.centroid)
        _scale(marker, _ROOM_DIAMETER)
        marker.color = _colour(colour)
        return marker

    def name(self, room: Room) -> Marker:
        marker = self.marker("room_names", room.id, Marker.TEXT_VIEW_FACING)
        x, y, z = room.centroid
        marker.pose.position = self.point((x, y, z + _ROOM_DIAMETER))
        marker.scale.z = _TEXT_HEIGHT
        marker.text = f"{room.id}: {room.area:.0f} m²"
        return marker

    def passages(self) -> Marker:
        marker = self.marker("passages", 0, Marker.CUBE_LIST)
        _scale(marker, _PASSAGE_EDGE)
        marker.points = [self.point(passage.position) for passage in self._map.passages]
        return marker

    def edges(self) -> Marker:
        marker = self.marker("edges", 0, Marker.LINE_LIST)
        marker.scale.x = _EDGE_WIDTH
        marker.points = [
            self.point(end)
            for passage in self._map.passages
            for room in passage.rooms
            for end in (self._map.room_by_id(room).centroid, passage.position)
        ]
        return marker


def _scale(marker: Marker, edge: float) -> None:
    marker.scale.x = marker.scale.y = marker.scale.z = edge


def _colour(rgb: Sequence[int] | NDArray[np.uint8]) -> ColorRGBA:
    red, green, blue = (float(value) / 255.0 for value in rgb)
    return ColorRGBA(r=red, g=green, b=blue, a=1.0)
