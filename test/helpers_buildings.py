"""Helpers of the tests of buildings: shapes, reachability, rays."""

from __future__ import annotations

import networkx as nx
import numpy as np


def square(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=np.float64)


def is_one_piece(building):
    """Whether links lead from every room to every other."""
    graph = nx.Graph()
    graph.add_nodes_from(room.id for room in building.rooms)
    graph.add_edges_from(link.rooms for link in building.links)
    return nx.is_connected(graph)


def first_hits(building, origins, directions):
    """Return how far rays (N, 3) go before they hit something, m."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(building.vertices.astype(np.float32)),
        o3d.core.Tensor(building.faces.astype(np.uint32)),
    )
    rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
    return scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()


def places_in(room, building, spacing=0.3):
    """Return places at breast height inside a room: (N, 3)."""
    low, high = room.polygon.min(axis=0), room.polygon.max(axis=0)
    x, y = np.meshgrid(*(np.arange(a + 0.1, b, spacing) for a, b in zip(low, high, strict=True)))
    places = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, room.z_low + 1.2)])
    return places[building.room_of(places, np.tile([0.0, 0.0, 1.0], (len(places), 1))) == room.id]
