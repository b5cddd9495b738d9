"""Searching for a part without a start, from all sides, in heavy clutter with a cable over it.

    python benchmarks/locate_clutter.py BRACKET --noise 3

Takes the photos of a scene by benchmarks/locate_scene.py and searches each for the part, over the whole sphere and at
all distances. Tells by how many px the corners of the best pose are off, its quality, and the CPU time.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from cadcam.locate.in_photos import locate_part
from locate_errors import NEAR_PX, vertex_error
from locate_sets import PhotoSet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="+", help="folders by benchmarks/locate_scene.py")
    parser.add_argument("--noise", type=int, default=3, help="grey levels (default %(default)s)")
    a = parser.parse_args()
    print("| scene | view | off, px | quality | CPU, s |\n|---|---|---|---|---|")
    for folder in a.scene:
        photos, right, found, wrong = PhotoSet(folder), 0, 0, 0
        views = [k for k in photos.truth if (folder / f"n{a.noise}/images/{k:04d}.png").exists()]
        for view in views:
            began = time.process_time()
            location = locate_part(photos.part, [photos.photo(a.noise, view)])
            took = time.process_time() - began
            error = vertex_error(photos, location.pose.world_from_part, photos.truth[view])
            right, found = right + (error < NEAR_PX), found + (error < NEAR_PX and location.found)
            wrong += error >= NEAR_PX and location.found
            print(f"| {photos.name} | {view} | {error:.1f} | {location.quality:.2f} | {took:.1f} |", flush=True)
        print(
            f"{photos.name}: right first {right} of {len(views)}, called found {found}, wrong and called found {wrong}"
        )


if __name__ == "__main__":
    main()
