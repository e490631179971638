"""Draw the README's picture from what `topometric merge` or `replay` wrote.

python -m topometric_ros.visualization.readme_picture OUT docs/images/demo.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from topometric_ros.alignment import GlobalMap
from topometric_ros.errors import TopometricError
from topometric_ros.io.map_files import load_global_map
from topometric_ros.visualization.figures import global_figure


def draw(folder: Path, picture: Path) -> None:
    """Draw the global map in `folder`, with what each agent saw outlined, into a PNG file.

    Raises
    ------
    TopometricError
        The folder has no global map, or the map is empty.
    """
    topometric_map, seen, agents = load_global_map(folder / "global.tmap")
    if seen is None:
        raise TopometricError(f"{folder / 'global.tmap'} does not say which agent saw what")
    placed = [name for k, name in enumerate(agents) if bool((seen >> np.uint32(k) & 1).any())]
    png = global_figure(GlobalMap(topometric_map, seen), agents, placed)
    if png is None:
        raise TopometricError(f"{folder / 'global.tmap'}: the map holds no voxels to draw")
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.write_bytes(png)


def main(arguments: list[str] | None = None) -> int:
    """Run the script; returns the exit status, 2 on bad input."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="what merge or replay wrote with -o")
    parser.add_argument("picture", type=Path, help="PNG file to write")
    options = parser.parse_args(arguments)
    try:
        draw(options.folder, options.picture)
    except TopometricError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
