#!/usr/bin/env python3
"""Write partial views of rooms to train on.

    make_room_views.py ROOMS.npz [BUILDING ...] [--generated N] [--first-seed S] [--seed S]

BUILDING is what `topometric simulate` takes: a labelled .ply, a folder of S3DIS, a BIM model, a
generator's name. N generated ones come before. Never train on a building that is measured on.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from room_views import generated_buildings, room_views


def main() -> None:
    """Look at all rooms and write the file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rooms", type=Path)
    parser.add_argument("buildings", nargs="*")
    parser.add_argument("--generated", type=int, default=0)
    parser.add_argument("--first-seed", type=int, default=10000, help="of the generated buildings")
    parser.add_argument(
        "--seed", type=int, default=0, help="of the places that rooms are seen from"
    )
    args = parser.parse_args()
    names = [*generated_buildings(args.generated, args.first_seed), *args.buildings]
    started = time.process_time()
    seen = room_views(names, args.seed)
    seen.save(args.rooms)
    spent = time.process_time() - started
    print(f"{len(seen.views)} rooms of {len(names)} buildings, {spent:.0f} CPU seconds")


if __name__ == "__main__":
    main()
