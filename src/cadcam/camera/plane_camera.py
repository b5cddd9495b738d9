"""The image of a plane (2D to 2D): the 3x3 matrix, both ways, and its relation to a camera in space.

Points of the plane (x, y) in mm, pixels q = (column, row): (q, 1) ~ H (x, y, 1), the third coordinate positive in front
of the camera. For a camera without lens distortion whose pose is camera_from_plane = [r0 r1 r2 | t], H = K [r0 r1 t].
Source: "Industrial Vision" (1997), section 6.3.2; Hartley and Zisserman, "Multiple View Geometry", chapter 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import PIXEL_FROM_UV
from cadcam.camera.fitted import Fitted, scaled
from cadcam.camera.lens import Ideal
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry import rotation as so3
from cadcam.geometry.coordinates import coordinates
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect

_SINGULAR = 1e-14  # 45 times the rounding of a number of size 1


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlaneCamera(Brief):
    """The 3x3 matrix H of (q, 1) ~ H (x, y, 1), pixels of plane points in mm; its sign determines the front."""

    matrix: Array

    def __post_init__(self) -> None:
        H = frozen(self.matrix, "plane to pixel matrix", (3, 3))
        if not _is_invertible(H):
            raise DegenerateGeometry("the plane's 3x3 matrix has no inverse: the plane is seen from its edge")
        object.__setattr__(self, "matrix", H)

    @classmethod
    def from_uv_matrix(cls, C: Floats) -> PlaneCamera:
        """Return the camera of the thesis' matrix with (U, V, 1) ~ C (x, y, 1), U the row and V the column (EQ 6.2)."""
        return cls(PIXEL_FROM_UV @ frozen(C, "plane to (U, V) matrix", (3, 3)))

    @classmethod
    def of(cls, camera: Camera, camera_from_plane: Rigid) -> PlaneCamera:
        """Return the map K [r0 r1 t] of the plane z = 0 of camera_from_plane by a camera without distortion."""
        expect(camera, "camera", Camera)
        expect_motion(camera_from_plane, "camera_from_plane")
        if not isinstance(camera.lens, Ideal):
            raise BadValue("lens", camera.lens.name, "ideal: no 3x3 matrix holds distortion (see Camera.unproject)")
        T = camera_from_plane
        return cls(camera.K @ np.column_stack([T.rotation[:, :2], T.translation]))

    @property
    def uv_matrix(self) -> Array:
        """Return the thesis' C (3, 3) with C22 = 1; `DegenerateGeometry` if the plane's origin has depth 0."""
        C = PIXEL_FROM_UV @ self.matrix
        if abs(C[2, 2]) <= 1e-12 * np.abs(C[2]).max():
            raise DegenerateGeometry("C22 = 1 is impossible: the plane's origin has depth 0; shift the origin")
        return np.asarray(C / C[2, 2])

    def facing(self, p: Floats) -> PlaneCamera:
        """Return the same camera with plane points (..., 2) in front: all of them, or `DegenerateGeometry`."""
        side = coordinates(p, "points of the plane", 2) @ self.matrix[2, :2] + self.matrix[2, 2]
        if np.all(side > 0):
            return self
        if np.all(side < 0):
            return PlaneCamera(-self.matrix)
        raise DegenerateGeometry(
            f"{min(int(np.sum(side <= 0)), int(np.sum(side >= 0)))} of {side.size} points lie beyond the plane's "
            "vanishing line: points and pixels do not belong together"
        )

    def project(self, p: Floats) -> Array:
        """Return pixels (..., 2) of plane points (..., 2) mm; NaN where they are not in front."""
        return self.project_with_jacobians(p)[0]

    def project_with_jacobians(self, p: Floats) -> tuple[Array, Array, Array]:
        """Return q (..., 2), dq/dp (..., 2, 2) px/mm and dq/d(the nine entries, row by row) (..., 2, 9); NaN behind."""
        p = coordinates(p, "points of the plane", 2)
        one = np.concatenate([p, np.ones((*p.shape[:-1], 1))], axis=-1)
        u = one @ self.matrix.T
        w = np.where(u[..., 2:] > 0, u[..., 2:], np.nan)
        q = u[..., :2] / w
        dq_dp = (self.matrix[:2, :2] - q[..., :, None] * self.matrix[2, :2]) / w[..., None]
        by_entry = np.zeros((*q.shape, 9))
        by_entry[..., 0, 0:3] = by_entry[..., 1, 3:6] = one / w
        by_entry[..., 6:9] = -q[..., :, None] * (one / w)[..., None, :]
        return q, dq_dp, by_entry

    def unproject(self, q: Floats) -> Array:
        """Return the plane points (..., 2) mm seen at pixels (..., 2) (EQ 6.8-6.10); NaN beyond the vanishing line."""
        q = coordinates(q, "pixels", 2)
        one = np.concatenate([q, np.ones((*q.shape[:-1], 1))], axis=-1)
        v = np.linalg.solve(self.matrix, one[..., None])[..., 0]
        return np.asarray(v[..., :2] / np.where(v[..., 2:] > 0, v[..., 2:], np.nan))

    def pose(self, camera: Camera) -> Rigid:
        """Return camera_from_plane for a camera of known K without distortion: the rotation nearest to K^-1 H."""
        A = np.linalg.solve(camera.K, self.matrix)
        A = np.asarray(A * 2 / (np.linalg.norm(A[:, 0]) + np.linalg.norm(A[:, 1])))
        return Rigid(so3.nearest(np.column_stack([A[:, 0], A[:, 1], np.cross(A[:, 0], A[:, 1])])), np.asarray(A[:, 2]))


def _is_invertible(H: Array) -> bool:
    """Return whether H has an inverse, whatever the plane's unit and however far its origin lies from what is seen.

    The third column, which is all that the origin changes, is compared with its part across the other two; a
    determinant of nine entries tends to 0 with the cube of that distance.
    """
    rows = np.linalg.norm(H, axis=1)
    if not rows.all():
        return False
    H = H / rows[:, None]
    columns = np.linalg.norm(H, axis=0)
    if not columns.all():
        return False
    x, y, origin = (H / columns).T
    normal = np.cross(x, y)
    area = float(np.linalg.norm(normal))
    return area > _SINGULAR and abs(normal @ origin) > _SINGULAR * area


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlaneEstimate(Fitted, Brief):
    """A plane's camera estimated from points of the plane Z = `height` of the world.

    cofactor (9, 9): the covariance of the matrix' entries, row by row, for noise of 1 px; of rank 8, since their common
    scale is arbitrary.
    """

    camera: PlaneCamera
    observations: Observations
    height: float
    cofactor: Array
    method: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cofactor", frozen(self.cofactor, "cofactor", (9, 9)))

    @property
    def residuals(self) -> Array:
        """Return measured minus projected pixels (N, 2)."""
        return np.asarray(self.observations.q - self.camera.project(self.observations.p_world[:, :2]))

    @property
    def unknowns(self) -> int:
        """Return 8."""
        return 8

    @property
    def covariance(self) -> Array:
        """Return the covariance (9, 9) of the matrix' entries, row by row; inf where the noise is unknown."""
        return scaled(self.cofactor, self.noise_px)

    def projection_covariance(self, p: Floats) -> Array:
        """Return the covariance (..., 2, 2) px^2 of the images of plane points (..., 2), due to the matrix' error."""
        J = self.camera.project_with_jacobians(p)[2]
        return np.asarray(J @ self.covariance @ np.swapaxes(J, -1, -2))
