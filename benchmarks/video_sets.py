"""Real videos with reference poses: what their files hold, in our conventions (mm, pixel centres at integers).

cube, teabox: poses `cMo` map model points (m) to the camera (OpenCV axes); `poses_visp` is ViSP 3.5.0's tracker (edges
and KLT), `poses_refined` the same polished by an edge fit, neither is a truth. m3t: the published pose is link2world,
and the mesh stands in the link by geometry2body.
"""

from __future__ import annotations

import csv
import json
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.track.frames import Frames

SIGMA_PX = 0.1


@dataclass(frozen=True)
class Clip:
    """Pictures of one camera with reference poses (camera_from_part) by frame number."""

    name: str
    model: Path
    camera_file: Path
    folder: Path
    refined: Path
    visp: Path
    camera_from_world: Rigid

    @cached_property
    def viewpoint(self) -> Viewpoint:
        """The camera in the world of the clip's rig."""
        return Viewpoint.exact(self.name, camera_of(self.camera_file), self.camera_from_world, sigma_px=SIGMA_PX)

    @cached_property
    def numbers(self) -> list[int]:
        """The frame number of each picture, by its name."""
        return [int(re.findall(r"\d+", Path(name).stem)[-1]) for name in sorted(p.name for p in self.folder.iterdir())]

    def world_from_part(self, path: Path) -> list[Rigid]:
        """Return a file's pose at each picture."""
        poses = poses_of(path)
        return [self.camera_from_world.inv @ poses[number] for number in self.numbers]


def clips(data: Path) -> dict[str, Clip]:
    """Return the clips of the public ViSP sets; left and right share the left camera's world."""
    cube, box = data / "visp_mbt_cube", data / "visp_teabox"
    right_from_left = _scaled(np.loadtxt(box / "cRightMcLeft.txt"))
    out = {"cube": Clip("cube", cube / "cube.obj", cube / "camera.json", cube / "cube", cube / "poses_refined.csv",
                        cube / "poses_visp.csv", Rigid())}  # fmt: skip
    for side in ("mono", "left", "right"):
        refined, visp = box / f"poses_refined_{side}.csv", box / f"poses_visp_{side}.csv"
        pose = right_from_left if side == "right" else Rigid()
        out[side] = Clip(
            side, box / "teabox.obj", box / f"camera_{side}.json", box / f"frames_{side}", refined, visp, pose
        )
    return out


def frames_of(*of: Clip) -> Frames:
    """Return the frames of clips that were taken together."""
    return Frames([clip.folder for clip in of], [clip.viewpoint for clip in of])


def part_of(clip: Clip) -> Part:
    """Return the clip's part."""
    return Part.of(read_model(clip.model, unit="m"))


def camera_of(path: Path) -> Camera:
    """Return the camera of a data set's own JSON."""
    said = json.loads(path.read_text())
    return Camera.from_focal((said["width"], said["height"]), said["fx"], fy=said["fy"], cx=said["cx"], cy=said["cy"])


def poses_of(path: Path) -> dict[int, Rigid]:
    """Return camera_from_part by frame number."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    names = [[f"r{i}{j}" for j in (1, 2, 3)] + [f"t{axis}"] for i, axis in zip((1, 2, 3), "xyz", strict=True)]
    return {int(row["frame"]): _scaled(np.array([[float(row[n]) for n in line] for line in names])) for row in rows}


def triangle(data: Path) -> tuple[Part, Camera, list[Path], Rigid]:
    """Return part, camera, pictures and the published camera_from_part of the wooden triangle of M3T."""
    folder = data / "m3t_triangle"
    text = (folder / "sequence/color_camera.yaml").read_text()
    f_u, f_v, x, y = (float(re.findall(rf"{key}: ([\d.]+)", text)[0]) for key in ("f_u", "f_v", "pp_x", "pp_y"))
    camera = Camera.from_focal((960, 540), f_u, fy=f_v, cx=x, cy=y)
    link = _yaml_matrix(folder / "body/triangle_static_detector.yaml")
    pose = link @ _yaml_matrix(folder / "body/triangle.yaml")
    pictures = sorted((folder / "sequence").glob("color_camera_image_*.png"))
    return Part.of(read_model(folder / "body/triangle.obj", unit="m")), camera, pictures, pose


def box_symmetries(part: Part) -> list[Rigid]:
    """Return the rotations that map the part's box onto itself, about its centre: 4 of a box, 24 of a cube.

    They are the part's own for a box; a model without its texture does not tell them apart.
    """
    low, high = part.scene.mesh.bounds
    centre, half = (low + high) / 2, (high - low) / 2
    turns = [so3.nearest(R) for R in _axis_turns() if np.allclose(np.abs(R) @ half, half, atol=1e-6 * half.max())]
    return [Rigid(R, centre - R @ centre) for R in turns]


def _axis_turns() -> list[Array]:
    """Return the 24 rotations that permute the axes."""
    from itertools import permutations, product

    every = [
        np.eye(3)[list(p)] * np.array(s)[:, None] for p in permutations(range(3)) for s in product((1, -1), repeat=3)
    ]
    return [R for R in every if np.linalg.det(R) > 0]


def _scaled(matrix: Array) -> Rigid:
    """Return the motion of a matrix in metres whose rotation has been rounded."""
    return Rigid(so3.nearest(matrix[:3, :3]), 1000 * matrix[:3, 3])


def _yaml_matrix(path: Path) -> Rigid:
    numbers = re.findall(r"data: \[(.*?)\]", path.read_text(), flags=re.DOTALL)[0]
    return _scaled(np.array([float(v) for v in re.split(r"[,\s]+", numbers.strip())]).reshape(4, 4))
