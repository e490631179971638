"""One setup.py for pip and colcon (ament_python): see docs/dependencies.md for the reasons."""

import re
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "topometric_ros"
VERSION = re.search(r'__version__ = "(.+)"', Path(f"{NAME}/__init__.py").read_text())[1]
# The same module without CUDA, a third of the size; it has wheels for this platform only.
OPEN3D_CPU = "sys_platform == 'linux' and platform_machine == 'x86_64'"

setup(
    name=NAME,
    version=VERSION,
    description="Topometric maps of buildings: extract them from point clouds, merge those of agents",
    long_description="Extracts rooms, passages and voxels from point clouds and merges agents' maps.",
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
        f"{NAME}.schemas": ["msg/*.msg", "srv/*.srv"],
        f"{NAME}.visualization": ["*.html", "*.js", "*.css"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "LICENSE"]),
        (f"share/{NAME}/config", glob("config/*")),
        (f"share/{NAME}/launch", glob("launch/*.py")),
        (f"share/{NAME}/rviz", glob("rviz/*.rviz")),
        (f"lib/{NAME}", glob("executables/*")),
    ],
    install_requires=[
        "numpy>=2.0",
        "scipy>=1.13",
        "numba>=0.61",
        f"open3d-cpu>=0.19; {OPEN3D_CPU}",
        f"open3d>=0.19; not ({OPEN3D_CPU})",
        "networkx>=3.2",
        "markov-clustering==0.0.6.dev0",
        "scikit-learn>=1.4",
        "mcap>=1.2",
        "rosbags>=0.11",
        "zstandard>=0.22",
        "pyyaml>=6.0",
        "matplotlib>=3.8",
    ],
    extras_require={
        "las": ["laspy[lazrs]>=2.5"],
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "test": ["pytest>=8", "hypothesis>=6.100", "laspy[lazrs]>=2.5"],
        "dev": ["ruff>=0.11", "mypy>=1.15", "pre-commit>=3.7", "colcon-common-extensions"],
    },
    entry_points={
        "console_scripts": [
            "topometric = topometric_ros.cli.main:main",
            "topometric-extractor = topometric_ros.nodes.extractor:main",
            "topometric-merger = topometric_ros.nodes.merger:main",
        ]
    },
    zip_safe=False,
)
