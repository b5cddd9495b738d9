"""A small job that the verbs are run on: a block, a camera that saw it, the points picked on its photo."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.files.camera import write_camera
from cadcam.files.points import write_points
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture

SIZE = (320, 240)
CAMERA = Camera.from_focal(SIZE, 400, fy=396, cx=165, cy=118, skew=0.8, lens=BrownConrady(k1=-0.05))
POSE = Rigid.look_at([180, -260, 200], [30, 20, 10])
CORNERS = np.array([[x, y, z] for x in (0, 60) for y in (0, 40) for z in (0, 20)], float)
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


@dataclass(frozen=True)
class Ran:
    """What a command printed and how it ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """The one JSON document on stdout."""
        document = json.loads(self.out)
        assert isinstance(document, dict)
        return document

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The JSON documents on stdout, one a line."""
        return [json.loads(line) for line in self.out.splitlines()]


def make_job(folder: Path) -> None:
    """Write block.obj (60 x 40 x 20 mm), points.csv, camera.json with its pose, and photo.png of its size."""
    vertices = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
    faces = "".join("f " + " ".join(str(i + 1) for i in face) + "\n" for face in FACES)
    (folder / "block.obj").write_text(vertices + faces)
    rng = np.random.default_rng(1)
    q = CAMERA.project(POSE @ CORNERS) + rng.normal(scale=0.1, size=(8, 2))
    write_points(folder / "points.csv", Observations(CORNERS, q, tuple("ABCDEFGH")))
    write_camera(folder / "camera.json", CAMERA, camera_from_world=POSE)
    write_picture(folder / "photo.png", rng.uniform(0.3, 0.6, (SIZE[1], SIZE[0])))


def replaced(path: Path, old: str, new: str) -> None:
    """Replace the first `old` in a file, which must hold it."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
