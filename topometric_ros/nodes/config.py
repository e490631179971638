"""What the nodes themselves can be told; the stages' own parameters stand beside these.

Free of rclpy, so that the reference and the YAML files are made where ROS is not installed.
"""

from __future__ import annotations

from dataclasses import dataclass

from topometric_ros.configuration import parameter

PRESETS = ("default", "thesis")


@dataclass(frozen=True)
class ExtractorNodeConfig:
    """The extractor's input, identity and pace."""

    agent: str = parameter("", "Short id of the agent; empty: the node's namespace.")
    preset: str = parameter(
        "default", "Defaults of all parameters of the extraction.", choices=PRESETS
    )
    mode: str = parameter(
        "auto",
        "Whether clouds are whole maps or single scans to be placed by /tf; auto: a cloud whose "
        "frame has a parent on /tf is a scan.",
        choices=("auto", "map", "scan"),
    )
    cloud_qos: str = parameter(
        "auto",
        "Reliability and durability of the cloud subscription; auto: the strongest that all "
        "publishers present offer.",
        choices=("auto", "reliable", "best_effort"),
    )
    map_frame: str = parameter(
        "", "Frame of the map that scans are placed in; empty: the root of their TF tree."
    )
    max_rate: float = parameter(
        0.5, "Extractions a second at most.", unit="Hz", minimum=0.001, maximum=100.0
    )
    scan_queue: int = parameter(
        200,
        "Scans that may wait while a map is extracted; then the oldest are dropped and counted.",
        minimum=1,
        maximum=100_000,
    )


@dataclass(frozen=True)
class MergerNodeConfig:
    """The merger's agents, frames and pace."""

    agents: tuple[str, ...] = parameter(
        (), "Namespaces of the agents, in order; the first that has a map anchors the global frame."
    )
    preset: str = parameter(
        "default", "Defaults of all parameters of the merging.", choices=PRESETS
    )
    global_frame: str = parameter("map", "Frame of the global map.")
    max_rate: float = parameter(
        0.5, "Merges a second at most.", unit="Hz", minimum=0.001, maximum=100.0
    )
    tf_rate: float = parameter(
        10.0, "Rate at which /tf is stamped anew.", unit="Hz", minimum=0.1, maximum=1000.0
    )
