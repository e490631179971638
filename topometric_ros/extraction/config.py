"""ExtractionConfig: every stage's configuration in one place, and the named presets."""

from __future__ import annotations

from dataclasses import dataclass, field

from topometric_ros.configuration import parameter
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.default_rooms import NarrowingsConfig
from topometric_ros.extraction.layers import LayersConfig
from topometric_ros.extraction.level import LevelConfig
from topometric_ros.extraction.navigation import NavigationConfig
from topometric_ros.extraction.passages import PassageConfig
from topometric_ros.extraction.room_kinds import RoomKindsConfig
from topometric_ros.extraction.storeys import StoreyConfig
from topometric_ros.extraction.thesis_rooms import ThesisRoomsConfig
from topometric_ros.extraction.viewpoints import ViewpointConfig
from topometric_ros.voxels.scan_grid import ScanConfig

PRESETS = ("default", "thesis")


@dataclass(frozen=True)
class ExtractionConfig:
    """From a cloud to a topometric map; the defaults are those of preset `default`."""

    voxel_size: float = parameter(
        0.1, "Edge of the map's voxels.", unit="m", minimum=0.02, maximum=1.0
    )
    method: str = parameter(
        "narrowings",
        "How rooms are found: floors cut at narrowings, or clusters of visibilities (the thesis).",
        choices=("narrowings", "visibility"),
    )
    scans: ScanConfig = field(default_factory=ScanConfig)
    level: LevelConfig = field(default_factory=LevelConfig)
    storeys: StoreyConfig = field(default_factory=StoreyConfig)
    layers: LayersConfig = field(default_factory=LayersConfig)
    navigation: NavigationConfig = field(
        default_factory=lambda: NavigationConfig(
            keep="all", largest_off_floor=4.0, gap=1.0, roofed_gap=3.0, treads=True
        )
    )
    viewpoints: ViewpointConfig = field(default_factory=lambda: ViewpointConfig(step=2, cover=4.0))
    narrowings: NarrowingsConfig = field(default_factory=NarrowingsConfig)
    views: ThesisRoomsConfig = field(default_factory=ThesisRoomsConfig)
    kinds: RoomKindsConfig = field(default_factory=RoomKindsConfig)
    passages: PassageConfig = field(
        default_factory=lambda: PassageConfig(step=0.1, smallest_contact=3, storeys=True)
    )


def extraction_preset(name: str) -> ExtractionConfig:
    """Return a named configuration: `default`, or `thesis` with every step as the draft says.

    Raises
    ------
    ConfigurationError
        There is no preset of that name.

    Examples
    --------
    >>> extraction_preset("thesis").method
    'visibility'
    """
    if name == "default":
        return ExtractionConfig()
    if name == "thesis":
        return ExtractionConfig(
            method="visibility",
            storeys=StoreyConfig(overhead=0.0),
            navigation=NavigationConfig(),
            viewpoints=ViewpointConfig(),
            passages=PassageConfig(),
        )
    raise ConfigurationError(f"unknown preset {name!r}; known: {', '.join(PRESETS)}")
