"""Find a box in real photos by its CAD model: in one photo, then in those of two cameras together.

Run it as `python examples/locate_on_photos.py FOLDER [OUT.png]`, FOLDER holding the tea box of ViSP's tutorial on
stereo tracking (https://github.com/lagadic/visp, GPL): frames_left and frames_right, camera_left.json and
camera_right.json (width, height, fx, fy, cx, cy), cRightMcLeft.txt (m) and the model teabox.obj (m). The start is some
15 degrees and 20 mm off; without one, `cadcam.locate_part(part, photos)`, the box is searched for from all sides, which
takes some seconds.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

import cadcam


def main(folder: Path, out: str) -> None:
    """Locate the box in the left photo, then in both; print how sure that is, draw it on both."""
    part = cadcam.Part.of(cadcam.read_model(folder / "teabox.obj", unit="m"))
    mount = np.loadtxt(folder / "cRightMcLeft.txt")
    mount[:3, 3] *= 1000  # m
    right_from_left = cadcam.Rigid.from_matrix(mount)
    photos = [
        cadcam.Photo.of(cadcam.read_picture(folder / f"frames_{side}/0000.jpg"), camera(folder, side), pose, name=side)
        for side, pose in (("left", cadcam.Rigid()), ("right", right_from_left))
    ]
    rough = cadcam.Rigid.from_rotation_vector(np.radians([130, 5, -10]), [-45, 60, 420])
    one = cadcam.locate_part(part, photos[:1], rough)
    print(f"left photo:  {said(one)}")
    both = cadcam.locate_part(part, photos, rough)
    print(f"both photos: {said(both)}")
    drawn = [draw(part, photo, both) for photo in photos]
    cadcam.write_picture(out, cadcam.side_by_side(*drawn))
    print(f"wrote {out}")


def camera(folder: Path, side: str) -> cadcam.Camera:
    """Return a camera of the set."""
    k = json.loads((folder / f"camera_{side}.json").read_text())
    return cadcam.Camera.from_focal((k["width"], k["height"]), k["fx"], fy=k["fy"], cx=k["cx"], cy=k["cy"])


def said(location: cadcam.Location) -> str:
    """Return where the box is, in words."""
    place = ", ".join(f"{v:.1f}" for v in location.pose.world_from_part.translation)
    return f"at ({place}) mm +- {np.linalg.norm(location.pose.sigma_mm):.2f}, quality {location.quality:.2f}"


def draw(part: cadcam.Part, photo: cadcam.Photo, location: cadcam.Location) -> np.ndarray:
    """Return the photo with the box's lines on it."""
    pose = photo.camera_from_world @ location.pose.world_from_part
    return cadcam.overlay(photo.gray, part.lines.draw(photo.camera, pose))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "located.png")
