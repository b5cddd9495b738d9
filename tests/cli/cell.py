"""A cell in which plates with ribs are judged: its files, how a rib that is off is photographed, how a line is run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cadcam.cad.mesh import Mesh
from cadcam.cad.write import write_model
from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, write_picture

from ..verify.scene import CAMERA, POSE, displaced, photographed, plate
from .job import Ran

Cadcam = Callable[..., Ran]
SIDE = Rigid.look_at((-620.0, -520.0, 500.0), (10.0, 0.0, 10.0))

TOLERANCES = """\
features:
  rib:
    part: rib 1
    position_mm: 0.5
    presence: required
"""


def make_cell(folder: Path) -> None:
    """Write plate.glb, camera.json, pose.txt (where the plate lies) and tolerances.yaml."""
    write_model(folder / "plate.glb", plate())
    write_camera(folder / "camera.json", CAMERA)
    rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in POSE.matrix)
    (folder / "pose.txt").write_text(f"# camera_from_part, mm\n{rows}\n")
    (folder / "tolerances.yaml").write_text(TOLERANCES)


def with_rib_off() -> Mesh:
    """Return the plate with a rib 1.5 mm off: three times its tolerance."""
    return displaced("rib 1", np.array([0.0, 1.5, 0.0]))


def make_line(folder: Path) -> None:
    """Write what `make_cell` writes, and photos of a good and a bad part, "A 9" and "A 10", in `in`."""
    make_cell(folder)
    (folder / "in").mkdir()
    rng = np.random.default_rng(5)
    moved = POSE @ Rigid(translation=(4.0, -6.0, 3.0))
    write_picture(folder / "in/A 9.png", photographed(plate(), rng, moved))
    write_picture(folder / "in/A 10.png", photographed(with_rib_off(), rng))


def put_like(photo: Path, *others: Path) -> None:
    """Write photos that differ from one, and from each other, by one grey value."""
    picture = read_picture(photo)
    for number, other in enumerate(others):
        one = picture.copy()
        one[0, number] = 1.0 - np.round(one[0, number])
        write_picture(other, one)


def inspected(cadcam: Cadcam, *more: str, photos: tuple[str, ...] = ("in",), camera: str = "camera.json") -> Ran:
    files = ("--camera", camera, "--start", "pose.txt", "--tolerances", "tolerances.yaml", "--reports", "out")
    return cadcam("inspect", *photos, "plate.glb", *files, *more)
