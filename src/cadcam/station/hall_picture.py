"""Pictures of a simulated hall: the marks as the hall's camera sees them, through its lens and its sensor."""

from __future__ import annotations

import os

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.files.shot import ShotPosition, write_pgm
from cadcam.geometry.rigid import Rigid
from cadcam.station.hall import Hall, Visit
from cadcam.target.marks.ideal import marks_picture
from cadcam.target.marks.mark import parse_mark

_LENS_PX = 0.7  # standard deviation of the lens' blur
_FLOOR, _PAPER, _INK = 0.35, 0.6, 0.05  # relative to the light that saturates the sensor
_FACE_UP = np.diag([1.0, -1.0, -1.0])  # a print's axes in the world: y down the print, z into the floor


def hall_picture(
    hall: Hall, camera: str, position: Array, marks: Array, visit: Visit, rng: np.random.Generator
) -> Picture:
    """Return the grey picture (H, W) in [0, 1] of marks at floor points (K, 2), as the camera delivers it."""
    mark = parse_mark(hall.plate.mark)
    there = hall.gantry(camera).camera_from_world(position, visit)
    poses = [there @ Rigid(_FACE_UP, np.array([x, y, 0.0])) for x, y in marks]
    alone = len(marks) == 1  # on a separate piece of paper; the marks of a plate share its white ground
    ground, margin = (_FLOOR, 0.8 * mark.radius) if alone else (_PAPER, 1.0)
    light = marks_picture(
        [mark] * len(poses),
        hall.camera,
        poses,
        paper=_PAPER,
        ink=_INK,
        background=ground,
        margin_mm=margin,
        blur_px=_LENS_PX,
    )
    return hall.sensor.apply(light, rng=rng)


def write_hall_picture(
    path: str | os.PathLike[str],
    hall: Hall,
    shot: ShotPosition,
    marks: Array,
    visit: Visit,
    rng: np.random.Generator,
) -> None:
    """Write such a picture as PGM, with the shot in its header."""
    write_pgm(path, hall_picture(hall, shot.camera, np.array([shot.x, shot.y]), marks, visit, rng), shot)
