"""The demo's building: ten rooms round an L-shaped corridor, no symmetry to fall for."""

from __future__ import annotations

from topometric_ros.simulation.building import (
    Area,
    Building,
    BuildingConfig,
    Opening,
    cabinet,
    make_building,
    table,
)

_NAMES = (
    *("corridor", "office west", "office south", "meeting room", "store", "laboratory"),
    *("workshop", "kitchen", "reading room", "studio", "office north"),
)

_AREAS = (
    Area(0, (0.0, 6.0, 14.2, 7.8)),
    Area(0, (14.2, 6.0, 16.0, 7.8)),
    Area(0, (14.2, 7.8, 16.0, 15.0)),
    Area(1, (0.0, 0.0, 4.4, 6.0)),
    Area(2, (4.4, 1.2, 8.0, 6.0)),
    Area(3, (8.0, 0.0, 13.6, 6.0)),
    Area(4, (13.6, 2.6, 16.0, 6.0)),
    Area(5, (16.0, 1.0, 22.4, 7.4)),
    Area(6, (16.0, 7.4, 22.4, 11.4)),
    Area(7, (16.0, 11.4, 20.0, 15.0)),
    Area(8, (0.0, 7.8, 5.4, 12.2)),
    Area(9, (5.4, 7.8, 9.6, 13.4)),
    Area(10, (9.6, 7.8, 14.2, 12.8)),
)

_DOORS = (
    *((3.2, 6.0), (5.4, 6.0), (9.4, 6.0), (14.8, 6.0)),
    *((16.0, 6.8), (16.0, 9.0), (16.0, 13.4)),
    *((1.4, 7.8), (8.6, 7.8), (14.2, 10.6)),
)

_WINDOWS = (
    *((0.0, 2.2, 1.6), (2.2, 0.0, 1.8), (6.2, 1.2, 1.4), (10.8, 0.0, 2.6)),
    *((22.4, 4.0, 2.4), (19.4, 1.0, 1.6), (22.4, 9.6, 1.6), (18.2, 15.0, 1.4)),
    *((0.0, 10.2, 1.6), (2.6, 12.2, 1.8), (7.4, 13.4, 1.6), (11.8, 12.8, 1.8)),
)

_FURNITURE = (
    *table(0.7, 2.4, 0.8, 1.6),
    *cabinet(4.0, 1.2, 0.5, 1.8, 1.8),
    *table(7.3, 2.2, 0.8, 1.5),
    *cabinet(5.0, 1.6, 0.9, 0.5, 1.2),
    *table(11.4, 2.0, 2.6, 1.1),
    *cabinet(13.2, 4.6, 0.5, 1.6, 0.9),
    *cabinet(15.6, 3.6, 0.5, 1.4, 1.8),
    *table(18.0, 2.0, 1.8, 0.8),
    *table(20.6, 2.0, 1.8, 0.8),
    *cabinet(22.0, 6.2, 0.5, 1.4, 1.8),
    *cabinet(19.0, 6.9, 2.0, 0.6, 0.9),
    *table(21.6, 9.0, 0.9, 1.8),
    *cabinet(18.4, 11.0, 1.6, 0.5, 1.8),
    *cabinet(18.6, 14.6, 1.8, 0.6, 0.9),
    *cabinet(19.6, 12.4, 0.6, 0.6, 1.8),
    *cabinet(5.0, 10.4, 0.5, 2.6, 1.8),
    *cabinet(0.7, 11.4, 0.9, 0.9, 0.8),
    *table(6.1, 11.8, 0.9, 1.8),
    *cabinet(9.2, 12.0, 0.5, 1.2, 1.6),
    *table(11.0, 8.5, 1.6, 0.8),
    *cabinet(10.0, 12.0, 0.5, 1.0, 1.8),
)


def office(config: BuildingConfig | None = None) -> Building:
    """Return the demo's building: 22.4 m by 15 m, ten rooms and a corridor, furnished."""
    openings = tuple(Opening("door", position, 0.9) for position in _DOORS)
    openings += tuple(Opening("window", (x, y), width) for x, y, width in _WINDOWS)
    return make_building(_NAMES, _AREAS, openings, _FURNITURE, config or BuildingConfig())
