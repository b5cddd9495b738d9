"""The coverage of a calibration: points over the picture, tilts, distances; and the uncertainty of directions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cadcam.arrays import Array, Brief, Mask, Picture, frozen
from cadcam.calibrate.boards.pictures import BoardCalibration
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import INTERNALS, internals_of
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.sensitivity import project_in_camera

_CELLS = (8, 6)  # columns and rows that a picture is divided into
_WIDE_DEG = 25.0  # range of tilt that a good set has about two axes
_AHEAD = 1000.0  # mm in front of the camera: arbitrary, since only directions count
_HUES = (
    (0.90, 0.10, 0.10), (0.10, 0.45, 0.85), (0.15, 0.65, 0.20), (0.85, 0.55, 0.05), (0.55, 0.20, 0.75),
    (0.05, 0.65, 0.65), (0.80, 0.20, 0.55), (0.45, 0.35, 0.15),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BoardCoverage(Brief):
    """Counts of points in the picture's cells (6, 8), upper left first; each view's tilts and distance.

    tilt_deg (k, 2): how far the right side of the board, as seen, is turned away from the camera, and its lower side.
    distance_mm (k,). sigma_px (6, 8): standard deviation of a pixel coordinate for a known direction at the middle of
    each cell, see `direction_sigma`; NaN where the lens images nothing.
    """

    counts: Array
    tilt_deg: Array
    distance_mm: Array
    sigma_px: Array

    def __post_init__(self) -> None:
        for name in ("counts", "tilt_deg", "distance_mm", "sigma_px"):
            shape = (None,) * np.ndim(getattr(self, name))
            object.__setattr__(self, name, frozen(getattr(self, name), name, shape, finite=name != "sigma_px"))

    @property
    def seen_share(self) -> float:
        """Return the share of the cells in which any point was seen."""
        return float((self.counts > 0).mean())

    def blank(self) -> list[str]:
        """Return the parts of the picture, of nine, in which no point was seen, as text."""
        rows, columns = self.counts.shape
        third = [np.array_split(np.arange(n), 3) for n in (rows, columns)]
        return [
            part_of_picture(x, y)
            for y in range(3)
            for x in range(3)
            if not self.counts[np.ix_(third[0][y], third[1][x])].any()
        ]

    def doubts(self) -> list[str]:
        """Return what is missing from the views, one sentence each."""
        out = [f"no point was seen {'; '.join(self.blank())}"] if self.blank() else []
        spread = np.ptp(self.tilt_deg, axis=0)
        for axis, name in enumerate(("sideways (about the board's vertical axis)", "up and down")):
            if spread[axis] < _WIDE_DEG:
                out.append(f"the board was tilted {name} over {spread[axis]:.0f} deg only")
        return out


def coverage(calibration: BoardCalibration) -> BoardCoverage:
    """Return where in the picture a calibration's views have points, and their tilts and distances."""
    estimate = calibration.estimate
    width, height = estimate.camera.size
    q = np.concatenate([view.q for view in estimate.views])
    counts, _, _ = np.histogram2d(
        q[:, 1], q[:, 0], bins=(_CELLS[1], _CELLS[0]), range=((-0.5, height - 0.5), (-0.5, width - 0.5))
    )
    return BoardCoverage(
        counts,
        tilts_deg(estimate.poses.rotation),
        calibration.distance_mm,
        direction_sigma(estimate).reshape(_CELLS[::-1]),
    )


def tilts_deg(rotation: Array) -> Array:
    """Return how far boards (k, 3, 3) turn their right side and their lower side away from the camera, (k, 2)."""
    normal = rotation[:, :, 2] * np.sign(rotation[:, 2:, 2])  # away from the camera
    return np.degrees(np.arctan2(-normal[:, :2], normal[:, 2:]))


def part_of_picture(x: int, y: int) -> str:
    """Return the name of a ninth of the picture; x, y from 0 (left, upper) to 2."""
    if (x, y) == (1, 1):
        return "in the middle of the picture"
    if x == 1:
        return f"at the {('upper', '', 'lower')[y]} edge"
    if y == 1:
        return f"at the {('left', '', 'right')[x]} edge"
    return f"in the {('upper', '', 'lower')[y]} {('left', '', 'right')[x]} corner"


def cell_centres(camera: Camera) -> Array:
    """Return the pixel (48, 2) in the middle of each cell, row by row."""
    x = (np.arange(_CELLS[0]) + 0.5) * camera.width / _CELLS[0] - 0.5
    y = (np.arange(_CELLS[1]) + 0.5) * camera.height / _CELLS[1] - 0.5
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def direction_sigma(estimate: JointEstimate) -> Array:
    """Return the standard deviation (48,) px of a coordinate for directions through the cells' middles, worst axis.

    A rotation of the camera as a whole is not an error of its internals, and is projected out: what is left is how well
    the camera measures angles between pixels (as in mrcal's projection uncertainty). Classical covariance. NaN where
    the lens images nothing.
    """
    index = [i for i, name in enumerate(estimate.free) if not name.startswith("bend")]
    return sigma_of(estimate.camera, [estimate.free[i] for i in index], estimate.covariance[np.ix_(index, index)])


def sigma_of(camera: Camera, free: list[str], covariance: Array) -> Array:
    """Return `direction_sigma` for any covariance of free internals and lens coefficients."""
    J = internal_sensitivity(camera, free)
    seen: Mask = np.asarray(np.isfinite(J).all(axis=(1, 2)))
    return np.where(seen, worst_sigmas(np.where(seen[:, None, None], J, 0.0), covariance), np.nan)


def worst_sigmas(J: Array, covariance: Array) -> Array:
    """Return the sigmas (...,) along the worst direction of pixels with derivatives J (..., 2, n) by the parameters."""
    C = J @ covariance @ np.swapaxes(J, -1, -2)
    return np.asarray(np.sqrt(np.linalg.eigvalsh(C)[..., -1].clip(0)))


def internal_sensitivity(camera: Camera, free: list[str]) -> Array:
    """Return dq/d(free) (48, 2, n) of directions through the cells' middles, without what a rotation would explain."""
    names = (*INTERNALS, *camera.lens.parameters)
    ray = camera.unproject(cell_centres(camera)) * _AHEAD
    _, dq_dp, dq_di = project_in_camera(internals_of(camera.K), camera.lens, ray, [names.index(name) for name in free])
    turn = -np.cross(dq_dp, ray[:, None])  # dq of exp(w) p: dq_dp (w x p) = -(dq_dp x p) . w
    ok = np.isfinite(ray).all(axis=1)
    A, B = turn[ok].reshape(-1, 3), dq_di[ok].reshape(-1, len(free))
    out = np.full(dq_di.shape, np.nan)
    out[ok] = (B - A @ np.linalg.lstsq(A, B, rcond=None)[0]).reshape(-1, 2, len(free))
    return out


def coverage_picture(calibration: BoardCalibration) -> Picture:
    """Return a picture (H, W, 3) of the camera's size: every point seen, one colour per view, each board's outline."""
    from cadcam.image.draw import draw_points, draw_polylines

    estimate = calibration.estimate
    width, height = estimate.camera.size
    out = np.ones((height, width, 3), dtype=np.float32)
    thick = max(width, height) / 640
    for k in range(1, 3):
        x, y = k * width / 3 - 0.5, k * height / 3 - 0.5
        lines = [[[x, -0.5], [x, height - 0.5]], [[-0.5, y], [width - 0.5, y]]]
        out = draw_polylines(out, lines, color=(0.8, 0.8, 0.8), width=thick)
    for j, view in enumerate(estimate.views):
        color = _HUES[j % len(_HUES)]
        outline = estimate.camera.project(estimate.pose(j) @ _border(calibration))
        out = draw_polylines(out, [outline], color=color, width=thick, opacity=0.5)
        out = draw_points(out, view.q, color=color, mark="circle", size=5 * thick, width=1.5 * thick)
    return out


def _border(calibration: BoardCalibration) -> Array:
    """Return the outline of the board's points in small steps (N, 3)."""
    high = calibration.pattern.points.max(axis=0)[:2]
    corner = np.array([[0, 0], [high[0], 0], high, [0, high[1]], [0, 0]])
    t = np.linspace(0, 1, 16)[:, None]
    sides = [a + t * (b - a) for a, b in pairwise(corner)]
    return np.column_stack([np.concatenate(sides), np.zeros(4 * len(t))])
