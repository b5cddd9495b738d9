"""A cell in which plates with ribs are judged: its files, and how a rib that is off is photographed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cadcam.cad.mesh import Mesh
from cadcam.cad.write import write_model
from cadcam.files.camera import write_camera

from ..verify.scene import CAMERA, POSE, displaced, plate

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
