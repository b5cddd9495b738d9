"""Two cameras compared: how far apart in px they image the same directions, as they are or after the best rotation.

A calibration fixes where the camera looks only up to its pose: two calibrations of one camera may differ by a small
rotation that any later pose estimate absorbs. What no rotation explains is the difference that matters; mrcal calls
this the implied rotation (mrcal `doc/differencing.org`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.camera.camera import Camera
from cadcam.camera.difference import difference_field, picture_grid
from cadcam.errors import DegenerateGeometry, SizeMismatch
from cadcam.fit.least_squares import minimise
from cadcam.geometry import rotation as so3
from cadcam.kinds import expect, expect_flag

_COLUMNS = 41


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Difference(Brief):
    """Where camera b images the directions that camera a sees, minus a's pixels.

    q: pixels of a (rows, columns, 2), from edge to edge. delta: q_b - q_a (rows, columns, 2) px, NaN where one of them
    sees nothing. b_from_a: the rotation (3, 3) between the camera frames that was allowed for, else the identity.
    """

    q: Array
    delta: Array
    b_from_a: Array

    @property
    def distance(self) -> Array:
        """Return |delta| (rows, columns) px."""
        return np.asarray(np.linalg.norm(self.delta, axis=-1))

    @property
    def max_px(self) -> float:
        """Return the largest distance, px."""
        return float(np.nanmax(self.distance))

    @property
    def rms_px(self) -> float:
        """Return the root mean square distance, px."""
        return float(np.sqrt(np.nanmean(self.distance**2)))

    @property
    def rotation_deg(self) -> float:
        """Return the angle of b_from_a in degrees."""
        return float(np.degrees(np.linalg.norm(so3.log(self.b_from_a))))

    @property
    def unseen(self) -> int:
        """Return how many of the pixels compared one of the cameras has no direction for."""
        return int(np.isnan(self.distance).sum())

    def places(self) -> dict[str, float]:
        """Return the distance at the centre and the four corners by name, px."""
        d = self.distance
        middle = d[d.shape[0] // 2, d.shape[1] // 2]
        corners = {"top left": d[0, 0], "top right": d[0, -1], "bottom left": d[-1, 0], "bottom right": d[-1, -1]}
        return {name: float(value) for name, value in {"centre": middle, **corners}.items()}


def compare_cameras(a: Camera, b: Camera, *, rotate: bool = False) -> Difference:
    """Return the difference field of two cameras over a's picture; with `rotate` after the best rotation.

    The rotation minimises the sum of squared pixel distances over the picture. Raises `SizeMismatch` for pictures of
    different sizes, `DegenerateGeometry` where the cameras see nothing in common.
    """
    expect(a, "a", Camera)
    expect(b, "b", Camera)
    expect_flag(rotate, "rotate")
    if a.size != b.size:
        remedy = f"resize or crop one of the cameras first: cadcam convert SECOND NEW --resize {a.width}x{a.height}"
        raise SizeMismatch("the second camera's picture", b.size, a.size, remedy)
    rows = _odd(_COLUMNS * a.height / a.width)
    q = picture_grid(a.size, _COLUMNS, rows)
    R = _best_rotation(a, b, q.reshape(-1, 2)) if rotate else np.eye(3)
    delta = difference_field(a, b, q, b_from_a=R)
    if np.isnan(delta).all():
        raise DegenerateGeometry("the two cameras see no direction in common: are they of the same kind?")
    return Difference(q, delta, R)


def _odd(n: float) -> int:
    return max(3, 2 * round((n - 1) / 2) + 1)


def _best_rotation(a: Camera, b: Camera, q: Array) -> Array:
    directions = a.unproject(q)
    seen = ~np.isnan(b.project(directions)).any(axis=1)
    if seen.sum() < 3:
        return np.eye(3)
    return minimise(_Turn(b, directions[seen], q[seen]), np.eye(3)).state


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    camera: Camera
    directions: Array
    q: Array

    def residuals_and_jacobian(self, state: Array) -> tuple[Array, Array]:
        """Return the distances (2 N,) px and their Jacobian by a rotation vector on the right of the state."""
        q, by_point = self.camera.project_with_jacobian(self.directions @ state.T)
        J = -by_point @ state @ so3.hat(self.directions)
        seen = np.asarray(~np.isnan(q).any(axis=1))  # directions moved beyond the lens do not count
        return np.where(seen[:, None], q - self.q, 0.0).ravel(), np.where(seen[:, None, None], J, 0.0).reshape(-1, 3)

    def retract(self, state: Array, step: Array) -> Array:
        """Return the rotation composed with a rotation vector."""
        return np.asarray(state @ so3.exp(step))
