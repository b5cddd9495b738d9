"""The view of the board to take next: candidate poses ranked by the information that each would add.

A view of N points adds the information J_i^T (1 - J_p (J_p^T J_p)^-1 J_p^T) J_i / sigma^2 on the internals, its own
pose eliminated (the Schur complement of one view's block). The pose that most reduces the worst standard deviation over
the picture (`coverage.direction_sigma`) is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.boards.coverage import internal_sensitivity, part_of_picture, worst_sigmas
from cadcam.calibrate.boards.pictures import BoardCalibration
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import INTERNALS, internals_of
from cadcam.camera.sensitivity import project_local
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_SIZES = (0.45, 0.7, 0.95)  # the board's width over the picture's, seen straight on
_TILTS_DEG = ((0, 0), (30, 0), (-30, 0), (0, 30), (0, -30), (45, 0), (-45, 0), (0, 45), (0, -45), (30, 30), (-30, -30))
_PLACES = tuple(product((-1, 0, 1), (-1, 0, 1)))
_INSIDE = 0.02  # of the picture's size: least distance of all points from its border


@dataclass(frozen=True, slots=True, eq=False)
class NextView:
    """A view to take: the proposed pose of the board, and the worst sigma over the picture before and after it, px.

    size: the board's width over the picture's if it were seen straight on; place: its middle in the picture, by ninths
    (0 left or upper, 2 right or lower); right_deg and lower_deg: how far its right and lower side turn away.
    """

    camera_from_board: Rigid
    size: float
    place: tuple[int, int]
    right_deg: float
    lower_deg: float
    before_px: float
    after_px: float

    def words(self) -> str:
        """Return the instruction for the person who holds the board."""
        how = f"hold the board {part_of_picture(*self.place)}, so near that it is about {self.size:.0%} as wide as the "
        return how + f"picture, {self._tilt()}"

    def _tilt(self) -> str:
        turns = []
        if self.right_deg:
            side = "right" if self.right_deg > 0 else "left"
            turns.append(
                f"about its vertical axis by {abs(self.right_deg):.0f} deg, its {side} side away from the camera"
            )
        if self.lower_deg:
            side = "lower" if self.lower_deg > 0 else "upper"
            turns.append(
                f"about its horizontal axis by {abs(self.lower_deg):.0f} deg, its {side} side away from the camera"
            )
        return f"and tilt it {' and '.join(turns)}" if turns else "and straight, not tilted"


def next_views(calibration: BoardCalibration, *, count: int = 3) -> list[NextView]:
    """Return the views to take next, the most useful first, each one chosen as if those before it had been taken.

    Empty where no candidate shows the whole board.
    """
    estimate = calibration.estimate
    index = [i for i, name in enumerate(estimate.free) if not name.startswith("bend")]
    free = [estimate.free[i] for i in index]
    J = internal_sensitivity(estimate.camera, free)
    J = np.where(np.isfinite(J), J, 0.0)
    information = np.asarray(np.linalg.inv(estimate.covariance[np.ix_(index, index)]), dtype=np.float64)
    tries = _candidates(estimate.camera, calibration.pattern.points)
    gains = [_gain(estimate.camera, t.camera_from_board, calibration.pattern.points, free) for t in tries]
    out: list[NextView] = []
    while tries and len(out) < count:
        before = _worst(J, information)
        after = np.array([_worst(J, information + g / estimate.noise_px**2) for g in gains])
        best = int(np.argmin(after))
        information = information + gains[best] / estimate.noise_px**2
        t = tries[best]
        out.append(NextView(t.camera_from_board, t.size, t.place, t.right_deg, t.lower_deg, before, float(after[best])))
    return out


def _worst(J: Array, information: Array) -> float:
    return float(worst_sigmas(J, np.asarray(np.linalg.inv(information))).max())


def _gain(camera: Camera, pose: Rigid, points: Array, free: list[str]) -> Array:
    """Return the information (n, n) that a view adds, with its pose eliminated, for pixels of unit noise."""
    _, J = project_local(pose.origin, pose.rotation, internals_of(camera.K), camera.lens, points)
    names = (*INTERNALS, *camera.lens.parameters)
    Ji = J[..., [6 + names.index(name) for name in free]].reshape(-1, len(free))
    Q = np.linalg.qr(J[..., :6].reshape(-1, 6))[0]
    rest = Ji - Q @ (Q.T @ Ji)
    return np.asarray(rest.T @ rest)


def _candidates(camera: Camera, points: Array) -> list[NextView]:
    """Return the candidate poses in which the camera sees the whole board."""
    out = []
    for size, place, tilt in product(_SIZES, _PLACES, _TILTS_DEG):
        pose = _pose(camera, points, size, place, tilt)
        if pose is not None and _in_view(camera, pose, points):
            x, y = place[0] + 1, place[1] + 1
            out.append(NextView(pose, size, (x, y), float(tilt[0]), float(tilt[1]), np.nan, np.nan))
    return out


def _pose(camera: Camera, points: Array, size: float, place: tuple[int, int], tilt: tuple[int, int]) -> Rigid | None:
    """Return the pose at which the board just stays within the picture at its `place`, None where there is no ray."""
    middle, extent = points.mean(axis=0), np.ptp(points, axis=0)
    distance = camera.fx * extent[0] / (size * camera.width)
    right, lower = np.radians(tilt)
    R = so3.exp(np.array([0.0, -right, 0.0])) @ so3.exp(np.array([lower, 0.0, 0.0]))
    for share in (0.36, 0.3, 0.24, 0.18, 0.12, 0.06):  # as far towards the border as the whole board stays visible
        q = (np.array(camera.size) - 1) / 2 + share * np.array(place) * np.array(camera.size)
        ray = camera.unproject(q)
        if not np.isfinite(ray).all():
            continue
        pose = Rigid(R, ray / ray[2] * distance - R @ middle)
        if place == (0, 0) or _in_view(camera, pose, points):
            return pose
    return None


def _in_view(camera: Camera, pose: Rigid, points: Array) -> bool:
    q = camera.project(pose @ points)
    margin = _INSIDE * max(camera.size)
    return bool(np.isfinite(q).all() and (q >= margin).all() and (q <= np.array(camera.size) - 1 - margin).all())
