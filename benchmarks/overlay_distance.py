"""Overlays on real photos by reference poses, and how far the visible lines are from the photos' edges.

    python benchmarks/overlay_distance.py ../shared/data out/

Writes PNG and SVG overlays to the folder and prints a table. The sets (their READMEs state the conventions): a video of
an 84 mm cube and one of a tea box with poses by another tracker, a triangular block partly behind a bottle, and a
path-traced ship block whose poses are exact.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.geometry import rotation
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, to_rgb, write_picture
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions
from cadcam.render.overlay import (
    add_pictures,
    blend_pictures,
    edge_distances,
    overlay,
    overlay_on_edges,
    side_by_side,
    write_overlay_svg,
)
from cadcam.render.ray import RayRenderer
from cadcam.render.view import Look, Scene
from video_sets import camera_of, poses_of


@dataclass(frozen=True)
class Shot:
    """A photo with the pose camera_from_model that is claimed for it."""

    photo: Path
    pose: Rigid


@dataclass(frozen=True)
class Photos:
    """A model, a camera and shots of one set."""

    name: str
    model: Path
    camera: Camera
    shots: list[Shot]


def cube(data: Path) -> Photos:
    folder = data / "visp_mbt_cube"
    poses = poses_of(folder / "poses_refined.csv")
    shots = [Shot(folder / f"cube/image{k:04d}.png", poses[k]) for k in range(0, 218, 6)]
    return Photos("visp_mbt_cube", folder / "cube.obj", camera_of(folder / "camera.json"), shots)


def teabox(data: Path) -> Photos:
    folder = data / "visp_teabox"
    poses = poses_of(folder / "poses_refined_mono.csv")
    files = sorted((folder / "frames_mono").glob("*.jpg"))
    shots = [Shot(f, poses[int(re.findall(r"\d+", f.stem)[-1])]) for f in files[::2]]
    return Photos("visp_teabox", folder / "teabox.obj", camera_of(folder / "camera_mono.json"), shots)


def triangle(data: Path) -> Photos:
    folder = data / "m3t_triangle"
    camera = Camera.from_focal((960, 540), 698.128, fy=698.617, cx=478.459, cy=274.426)
    numbers = re.findall(
        r"-?\d+\.\d+|\b[01]\b", (folder / "body/triangle_static_detector.yaml").read_text().split("data:")[1]
    )
    world_from_link = _rigid(np.array([float(x) for x in numbers[:16]]).reshape(4, 4))
    body_from_mesh = Rigid(np.eye(3), np.array([0.0, 0.0, -6.0]))  # geometry2body_pose in triangle.yaml
    shots = [Shot(folder / "sequence/color_camera_image_200.png", world_from_link @ body_from_mesh)]
    return Photos("m3t_triangle", folder / "body/triangle.obj", camera, shots)


def ship_block(data: Path) -> Photos:
    folder = data / "shipblock_clean"
    K = np.loadtxt(folder / "K.txt")
    shots = [Shot(folder / f"n0/images/{k:04d}.png", pose) for k, pose in poses_of(folder / "gt.csv").items()]
    return Photos("shipblock_clean", folder / "model.obj", Camera((768, 576), K), shots)


def measure(photos: Photos, out: Path) -> tuple[Array, int]:
    """Return the distances of all shots and their number; writes pictures of the first, middle and last."""
    scene = Scene.of(read_model(photos.model, unit="m"))
    drawer, renderer = LineDrawer(scene), RayRenderer(scene)
    chosen = {0, len(photos.shots) // 2, len(photos.shots) - 1}
    distances = []
    for k, shot in enumerate(photos.shots):
        photo = read_picture(shot.photo)
        wireframe = drawer.draw(photos.camera, shot.pose, options=LineOptions(hidden=True))
        distances.append(edge_distances(photo, wireframe))
        if k in chosen:
            view = renderer.render(photos.camera, shot.pose, look=Look(supersampling=3))
            lines = overlay(photo, wireframe)
            name = out / f"{photos.name}_{k:03d}"
            write_picture(f"{name}.png", side_by_side(to_rgb(photo), lines))
            write_picture(
                f"{name}_shaded.png",
                side_by_side(overlay(blend_pictures(photo, view), wireframe), add_pictures(photo, view)),
            )
            write_picture(f"{name}_edges.png", overlay_on_edges(photo, wireframe))
            write_overlay_svg(f"{name}.svg", wireframe, photo=photo, title=photos.name)
    return np.concatenate(distances), len(photos.shots)


def _rigid(matrix: Array) -> Rigid:
    """Return the motion in mm of a printed 4x4 matrix in metres, its rotation made orthonormal."""
    return Rigid(rotation.nearest(matrix[:3, :3]), 1000 * matrix[:3, 3])


def _table(data: Path, out: Path) -> Iterator[str]:
    yield "| set | photos | line points | median px | 90 % px | within 2 px | no edge in that direction |"
    yield "|---|---|---|---|---|---|---|"
    for photos in (cube(data), teabox(data), triangle(data), ship_block(data)):
        d, n = measure(photos, out)
        close, none = np.mean(d < 2), np.mean(np.isinf(d))
        median, most = np.quantile(d, [0.5, 0.9], method="higher")
        yield f"| {photos.name} | {n} | {len(d)} | {median:.2f} | {most:.2f} | {close:.0%} | {none:.1%} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the photo sets")
    parser.add_argument("out", type=Path, help="folder for the overlays")
    arguments = parser.parse_args()
    for line in _table(arguments.data, arguments.out):
        print(line)


if __name__ == "__main__":
    main()
