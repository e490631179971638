"""A cloud made ready: thinned, levelled, put into voxels, its storeys found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.assemble import majority
from topometric_ros.extraction.columns import Columns, sort_columns
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.extent import anchor, far_findings, without_islands, without_strays
from topometric_ros.extraction.layers import refine_floor
from topometric_ros.extraction.level import Level, estimate_level, no_floor, tilt_findings
from topometric_ros.extraction.overhead import storeys_without_overhead
from topometric_ros.extraction.quality import Finding
from topometric_ros.extraction.storeys import (
    RASTER,
    StoreyHeights,
    assign_storeys,
)
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.voxels.grid import VoxelGrid, means, thin, voxelise

_FINEST_LAYERS = 0.05
"""The rasters of storeys are made of points thinned to at most this cell (m)."""


@dataclass(frozen=True)
class Scene:
    """A levelled cloud of P thinned points in voxels, and its storeys; level frame, m.

    `grid` holds the map's N voxels, `raster` the R voxels of 0.1 m; both are the same, and so are
    `cell_of_point` and `raster_of_point`, where the map's voxels have that size.
    """

    points: NDArray[np.float64]
    """(P, 3)."""
    T_level_input: NDArray[np.float64]
    """(4, 4)."""
    tilt: float
    """rad, what was taken out."""
    findings: tuple[Finding, ...]
    grid: VoxelGrid
    cell_of_point: NDArray[np.int64]
    """(P,), the row of each point's voxel in `grid`."""
    raster: VoxelGrid
    raster_of_point: NDArray[np.int64]
    """(P,), the same in `raster`."""
    columns: Columns
    """The voxels of `raster` by columns."""
    means: NDArray[np.float64]
    """(R, 3), the mean of each voxel's points."""
    storeys: tuple[StoreyHeights, ...]
    """From below."""
    storey_of_raster: NDArray[np.int32]
    """(R,), the row of each voxel's storey in `storeys`."""

    @property
    def columns_of_grid(self) -> Columns | None:
        """The voxels of `grid` by columns where they are at hand, else None."""
        return self.columns if self.cell_of_point is self.raster_of_point else None

    @property
    def heights(self) -> NDArray[np.float64]:
        """The mean height of the points of each 0.1 m voxel: (R,), m."""
        return _heights(self.means)

    @property
    def means_of_grid(self) -> NDArray[np.float64]:
        """The mean of the points of each voxel of `grid`: (N, 3), m."""
        if self.cell_of_point is self.raster_of_point:
            return self.means
        return means(self.points, self.cell_of_point, len(self.grid))

    def per_voxel(self, labels: NDArray[np.int32]) -> NDArray[np.int32]:
        """Carry labels (R,) of the 0.1 m voxels over to the map's voxels: (N,) int32."""
        if self.cell_of_point is self.raster_of_point:
            return labels
        return majority(self.cell_of_point, labels[self.raster_of_point])


def make_scene(
    points: NDArray[np.float64],
    config: ExtractionConfig,
    origin: tuple[float, float, float] | None,
    T_level_input: NDArray[np.float64] | None,
    watch: Stopwatch,
    thinned: bool = False,
) -> Scene:
    """Thin and level a cloud, find its storeys and put it into voxels.

    The parameters are those of :func:`topometric_ros.extraction.pipeline.extract`.
    """
    if len(points) == 0:
        raise ExtractionError("no points to extract a map from")
    with watch.stage("thin"):
        points, strays = without_strays(np.asarray(points, np.float64))
        middle = _middle(points, T_level_input)
        far = far_findings(points, middle)
        points = points - middle if middle.any() else points
        if not thinned:
            points = thin(points, min(config.voxel_size / 2, _FINEST_LAYERS))
        points, islands = without_islands(points)
    with watch.stage("level"):
        points, level, voxels = _levelled(points, T_level_input, config)
        R = level.T_level_input[:3, :3]
    with watch.stage("storeys"):
        (raster, raster_of_point, mean), columns, storeys = _on_floor(
            points, voxels, origin, config
        )
        storey_of_raster = assign_storeys(columns, _heights(mean), storeys)
    with watch.stage("voxelise"):
        if config.voxel_size == RASTER:
            grid, cell_of_point = raster, raster_of_point
        else:
            grid, cell_of_point = voxelise(points, config.voxel_size, raster.origin)
    if T_level_input is None:
        T_level_input = level.T_level_input.copy()
        T_level_input[:3, 3] = -R @ middle + 0.0
    return Scene(
        points,
        T_level_input,
        level.tilt,
        (*strays, *islands, *far, *level.findings),
        grid,
        cell_of_point,
        raster,
        raster_of_point,
        columns,
        mean,
        storeys,
        storey_of_raster,
    )


_Voxels = tuple[VoxelGrid, NDArray[np.int64], NDArray[np.float64]]
"""The 0.1 m voxels of points, the voxel of each point and the mean of each voxel."""


def _voxels(points: NDArray[np.float64], lattice: NDArray[np.float64]) -> _Voxels:
    raster, raster_of_point = voxelise(points, RASTER, lattice)
    return raster, raster_of_point, means(points, raster_of_point, len(raster))


def _heights(mean: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ascontiguousarray(mean[:, 2])


def _middle(
    points: NDArray[np.float64], T_level_input: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Return where the level frame begins, (3,) m, input frame: as before in a session."""
    if T_level_input is None:
        return anchor(points)
    return np.asarray(-T_level_input[:3, :3].T @ T_level_input[:3, 3] + 0.0)


def _levelled(
    points: NDArray[np.float64],
    T_level_input: NDArray[np.float64] | None,
    config: ExtractionConfig,
) -> tuple[NDArray[np.float64], Level, _Voxels | None]:
    """Turn a cloud as it is estimated to lie, or as an earlier map of the session has it.

    Where it was not turned, its voxels on the frame's own lattice come with it if they were made.
    """
    voxels = None
    if T_level_input is None:
        voxels = _voxels(points, np.zeros(3))
        level = estimate_level(points, config.level, voxels[2])
    else:
        T = np.array(T_level_input, np.float64)
        tilt = float(np.arccos(np.clip(T[2, 2], -1.0, 1.0)))
        level = Level(T, tilt, tilt_findings(tilt))
    R = level.T_level_input[:3, :3]
    if np.array_equal(R, np.eye(3)):
        return points, level, voxels
    return points @ R.T, level, None


def _on_floor(
    points: NDArray[np.float64],
    voxels: _Voxels | None,
    origin: tuple[float, float, float] | None,
    config: ExtractionConfig,
) -> tuple[_Voxels, Columns, tuple[StoreyHeights, ...]]:
    """Put points into voxels and find the storeys.

    The lattice is that of the session's `origin`, or else has a layer of centres on the lowest
    floor; `voxels` are those on the frame's own lattice where they are at hand.
    """
    if origin is not None:
        voxels = _voxels(points, np.array(origin, np.float64))
        return voxels, *_storeys(points, voxels, config)
    voxels = _voxels(points, np.zeros(3)) if voxels is None else voxels
    _, storeys = _storeys(points, voxels, config)
    lowest = refine_floor(points, storeys[0].floor, config.layers)
    voxels = _voxels(points, np.array([0.0, 0.0, lowest]))
    return voxels, *_storeys(points, voxels, config)


def _storeys(
    points: NDArray[np.float64], voxels: _Voxels, config: ExtractionConfig
) -> tuple[Columns, tuple[StoreyHeights, ...]]:
    """Sort voxels into columns, find the storeys; raises ExtractionError without a floor."""
    raster, _, mean = voxels
    columns, storeys = storeys_without_overhead(
        sort_columns(raster.coords), _heights(mean), float(raster.origin[2]), config.storeys
    )
    if not storeys:
        raise no_floor(points, config.level)
    return columns, storeys
