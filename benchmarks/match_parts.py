"""Matching parts in photos by windows of their drawing: which appearance works, on which parts, how well.

    python benchmarks/match_parts.py ../shared/data [--shots 6]

Reference poses (exact for the ship block, another tracker's for cube and tea box) are turned by 6 degrees, shifted by
15 px and by 3 % of depth, each in a random direction; `cadcam.match_templates` starts there. right: found, and no
vertex farther than 5 px from where the reference has it; wrong: found, but farther.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np

from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, to_gray
from cadcam.locate.match.appearance import APPEARANCES, Appearance
from cadcam.locate.match.templates import TemplateOptions, match_templates
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from overlay_distance import Photos, Shot, cube, ship_block, teabox

DEGREES, PX, DEPTH, RIGHT_PX = 6.0, 15.0, 0.03, 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the public data sets")
    parser.add_argument("--shots", type=int, default=6, help="photos a set")
    arguments = parser.parse_args()
    print("| set | appearance | photos | right | wrong | not found | median px | matches of features | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for photos in (ship_block(arguments.data), cube(arguments.data), teabox(arguments.data)):
        part = Part.of(read_model(photos.model, unit="m"))
        for appearance in APPEARANCES:
            row(photos, part, appearance, arguments.shots)


def row(photos: Photos, part: Part, appearance: Appearance, count: int) -> None:
    """Match a part in some photos of a set and print a line of the table."""
    rng, misses, shares, seconds = np.random.default_rng(5), [], [], []
    for shot in photos.shots[:: -(-len(photos.shots) // count)]:
        photo = Photo.of(to_gray(read_picture(shot.photo)), photos.camera)
        start = disturbed(shot, part, photos.camera, rng)
        began = time.process_time()
        matches = match_templates(part, [photo], start, options=TemplateOptions(appearance=appearance))
        seconds.append(time.process_time() - began)
        shares.append(f"{len(matches.q)}/{len(matches.features)}")
        found = matches.found and matches.pose is not None
        misses.append(
            miss(photos.camera, part, matches.pose.world_from_part, shot) if found and matches.pose else np.nan
        )
    miss_px = np.array(misses)
    right, wrong = miss_px < RIGHT_PX, miss_px >= RIGHT_PX
    median = f"{np.median(miss_px[right]):.2f}" if right.any() else "-"
    print(
        f"| {photos.name} | {appearance} | {len(misses)} | {int(right.sum())} | {int(wrong.sum())} | "
        f"{int(np.isnan(miss_px).sum())} | {median} | {sorted(shares)[len(shares) // 2]} | {np.median(seconds):.2f} |",
        flush=True,
    )


def disturbed(shot: Shot, part: Part, camera: Camera, rng: np.random.Generator) -> Rigid:
    """Return the pose of a shot, turned about the part's middle and shifted."""
    middle = part.scene.mesh.vertices.mean(axis=0)
    z = float((shot.pose @ middle)[2])
    axis, way = rng.normal(size=3), rng.normal(size=2)
    turn = Rigid.exp([0, 0, 0, *(math.radians(DEGREES) * axis / np.linalg.norm(axis))])
    shift = [*(PX * way / np.linalg.norm(way) * z / camera.fx), DEPTH * z * rng.choice([-1, 1])]
    at = Rigid(translation=middle)
    return Rigid(translation=np.array(shift)) @ shot.pose @ at @ turn @ at.inv


def miss(camera: Camera, part: Part, pose: Rigid, shot: Shot) -> float:
    """Return the largest distance in px of a vertex from where the reference pose has it."""
    p = part.scene.mesh.vertices
    return float(np.nanmax(np.linalg.norm(camera.project(pose @ p) - camera.project(shot.pose @ p), axis=1)))


if __name__ == "__main__":
    main()
