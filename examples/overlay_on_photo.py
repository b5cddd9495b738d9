"""From points on a photo to the CAD wireframe on it.

Run it as `python examples/overlay_on_photo.py [OUT.png]`. The photo (synthetic: a ship's double-bottom block, through a
lens with distortion and skewed pixels) and the points picked in it lie in examples/data, the CAD model in models.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import cadcam

HERE = Path(__file__).parent


def main(out: str) -> None:
    """Calibrate the photo's camera from the points, remove the hidden lines, draw the rest, say how well they fit."""
    photo = cadcam.read_picture(HERE / "data" / "block_photo.jpg")
    points = cadcam.read_points(HERE / "data" / "block_points.csv")
    height, width = photo.shape[:2]
    seen = cadcam.calibrate_camera(points, size=(width, height), lens=cadcam.BrownConrady(), free_lens=["k1"])

    scene = cadcam.Scene.of(cadcam.read_model(HERE.parent / "models" / "shipblock_10k.obj"))
    wires = cadcam.visible_wireframe(scene, seen.camera, seen.camera_from_world)
    cadcam.write_picture(out, cadcam.overlay(photo, wires))

    distance = cadcam.edge_distances(photo, wires)
    print(f"{len(points)} points, residual {seen.thesis_residual:.2f} px; {len(wires.visible)} visible lines")
    print(f"median distance of the lines to the photo's edges: {np.median(distance):.2f} px")
    print(f"wrote {out}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "overlay.png")
