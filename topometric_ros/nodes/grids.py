"""One storey of the global map as the occupancy grid that Nav2 plans on."""

from __future__ import annotations

import numpy as np
from nav_msgs.msg import OccupancyGrid

from topometric_ros.errors import TopometricError
from topometric_ros.io.occupancy import occupancy_grid
from topometric_ros.topometric_map import Storey, TopometricMap

LARGEST = -1
"""As the wanted storey: the one of which most floor was seen."""


class GridError(TopometricError):
    """A storey that the map does not have, or a frame that no grid can lie in."""


def storey_grid(m: TopometricMap, wanted: int, frame: str) -> OccupancyGrid | None:
    """Return the grid of one storey as a message, None where the map has no storeys yet.

    Parameters
    ----------
    m : the global map
    wanted : id of the storey, or LARGEST
    frame : name of the frame of the map's input, in which the grid lies

    Raises
    ------
    GridError
        The map has no such storey, or its frame's z is not up.
    """
    if not m.storeys:
        return None
    grid = occupancy_grid(m, _storey(m, wanted))
    if grid.level:
        raise GridError(f"global_grid: z of frame {frame!r} is not up, so no grid can lie in it")
    message = OccupancyGrid()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(m.stamp, 10**9)
    message.info.map_load_time = message.header.stamp
    message.info.resolution = grid.resolution
    message.info.height, message.info.width = grid.values.shape
    x, y, yaw = grid.origin
    pose = message.info.origin
    pose.position.x, pose.position.y, pose.position.z = x, y, grid.floor_z
    pose.orientation.z, pose.orientation.w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
    message.data = grid.values.ravel().tolist()
    return message


def _storey(m: TopometricMap, wanted: int) -> Storey:
    if wanted == LARGEST:
        return max(m.storeys, key=lambda storey: (int(storey.layers.free.sum()), -storey.id))
    for storey in m.storeys:
        if storey.id == wanted:
            return storey
    known = ", ".join(str(storey.id) for storey in m.storeys)
    raise GridError(f"global_grid: no storey {wanted}; known: {known}")
