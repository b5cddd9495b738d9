"""The conventions of a robot's numbers that agree with the camera's motion: tested, not guessed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cadcam.calibrate.handeye.checks import reading
from cadcam.calibrate.handeye.estimate import Mounting
from cadcam.errors import DegenerateGeometry
from cadcam.fit.hand_eye_poses import HandEyePoses
from cadcam.geometry.rigid import Rigid

_WORSE = 4.0  # times the best reading's residual rotation, beyond which a reading is rejected
_LEAST = np.radians(0.5)


@dataclass(frozen=True, slots=True)
class ConventionFit:
    """How one reading of a robot's numbers fits: medians over motions of the residual rotation (rad) and position (mm).

    inverted: read as flange_from_base. scale: the robot's lengths over the camera's, 1 where the units agree. fits: the
    rotations agree as well as those of the best reading, and the positions to 5 % of the robot's way between poses.
    """

    convention: str
    inverted: bool
    rotation: float
    translation: float
    scale: float
    fits: bool


def conventions_that_fit(
    readings: Mapping[str, Rigid], camera_from_target: Rigid, *, mounting: Mounting
) -> tuple[ConventionFit, ...]:
    """Return how each reading base_from_flange (n), and its inverse, agrees with the camera's motion, the best first.

    Rotation and position are tested through A X = X B with the unit free. Several may fit: yaskawa and fanuc are one
    convention with two names, and so are inverted poses and the other mounting.
    """
    seen = camera_from_target if mounting == "eye-in-hand" else camera_from_target.inv
    nothing = np.zeros((len(seen.rotation), 6, 6))
    found = []
    for name, poses in readings.items():
        for inverted in (False, True):
            robot = poses.inv if inverted else poses
            try:
                left = reading(HandEyePoses(robot, seen, nothing))
            except DegenerateGeometry:
                continue
            way = float(np.median(np.linalg.norm(robot.translation - np.median(robot.translation, axis=0), axis=1)))
            found.append((name, inverted, left, left.translation < 0.05 * way))
    best = min((left.rotation for *_, left, near in found if near), default=np.inf)
    bound = min(max(_WORSE * best, _LEAST), np.radians(10.0))
    fits = [
        ConventionFit(name, inverted, left.rotation, left.translation, left.scale, near and left.rotation <= bound)
        for name, inverted, left, near in found
    ]
    return tuple(sorted(fits, key=lambda f: (not f.fits, f.rotation * (f.translation + 1e-3))))
