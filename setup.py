"""One setup.py for pip and colcon (ament_python): see docs/dependencies.md for the reasons."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "topometric_ros"
VERSION = re.search(r'__version__ = "(.+)"', Path(f"{NAME}/__init__.py").read_text())[1]
# open3d-cpu is the same module without CUDA, a third of the size, with wheels for this platform.
X86_LINUX = "sys_platform == 'linux' and platform_machine == 'x86_64'"
ELSEWHERE = "sys_platform != 'linux' or platform_machine != 'x86_64'"


def files(pattern: str) -> list[str]:
    """Return the files of the repository that match, for data_files."""
    return sorted(str(path) for path in Path().glob(pattern) if path.is_file())


setup(
    name=NAME,
    version=VERSION,
    description="Extracts topometric maps from point clouds and merges those of several agents",
    long_description="Rooms, passages and voxels of buildings; see README.md in the repository.",
    author="topometric_ros maintainers",
    maintainer="topometric_ros maintainers",
    maintainer_email="maintainers@topometric-ros.org",
    license="Apache-2.0",
    python_requires=">=3.11",
    # The texts of the interface package are a package of data of ours, for bags without ROS.
    packages=[*find_packages(include=[NAME, f"{NAME}.*"]), f"{NAME}.schemas"],
    package_dir={f"{NAME}.schemas": "msg_schemas/topometric_msgs"},
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.fusion": ["*.onnx"],
        f"{NAME}.matching": ["*.npy"],
        f"{NAME}.matching.descriptors": ["*.onnx"],
        f"{NAME}.schemas": ["msg/*.msg", "srv/*.srv"],
        f"{NAME}.visualization": ["*.html", "*.js", "*.css"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "LICENSE"]),
        (f"share/{NAME}/config", files("config/*")),
        (f"share/{NAME}/config/suites", files("config/suites/*")),
        (f"share/{NAME}/launch", files("launch/*.py")),
        (f"share/{NAME}/rviz", files("rviz/*.rviz")),
        (f"share/{NAME}/security", files("security/*.xml")),
        (f"lib/{NAME}", files("executables/*")),
    ],
    install_requires=[
        "numpy>=2.0",
        "scipy>=1.13",
        "numba>=0.61",
        f"open3d-cpu>=0.19; {X86_LINUX}",
        f"open3d>=0.19; {ELSEWHERE}",
        "networkx>=3.2",
        "scikit-learn>=1.4",
        "mcap>=1.2",
        "rosbags>=0.11",
        "zstandard>=0.22",
        "pyyaml>=6.0",
        "matplotlib>=3.8",
        "plotly>=5.20",
    ],
    extras_require={
        # Its wheels end at Python 3.12; without it the benchmark leaves that method out.
        "benchmark": ["kiss-matcher>=1.0; python_version < '3.13'"],
        "gicp": ["small_gicp>=1.0"],
        "learned": ["onnxruntime>=1.20"],
        "train": ["torch>=2.6", "onnx>=1.17"],
        "las": ["laspy[lazrs]>=2.5"],
        "e57": ["pye57>=0.4.17"],
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "test": [
            "pytest>=8",
            "hypothesis>=6.100",
            "laspy[lazrs]>=2.5",
            f"pye57>=0.4.17; {X86_LINUX}",
            "onnxruntime>=1.20",
            "markov-clustering==0.0.6.dev0",
        ],
        "dev": ["ruff>=0.11", "mypy>=1.15", "pre-commit>=3.7", "colcon-common-extensions"],
    },
    entry_points={
        "console_scripts": [
            "topometric = topometric_ros.cli.main:main",
            "topometric-extractor = topometric_ros.nodes.extractor:main",
            "topometric-merger = topometric_ros.nodes.merger:main",
            "topometric-player = topometric_ros.nodes.player:main",
            "topometric-managed-extractor = topometric_ros.nodes.managed:extractor",
            "topometric-managed-merger = topometric_ros.nodes.managed:merger",
        ]
    },
    zip_safe=False,
)
