"""The camera: picture size, camera matrix with skew, lens. Its pose is never part of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cadcam.arrays import Array, Floats, Locked, Mask, frozen
from cadcam.camera.lens import Ideal, Lens, lens_from_opencv
from cadcam.errors import BadValue
from cadcam.geometry.coordinates import coordinates
from cadcam.kinds import expect, expect_number


@dataclass(frozen=True, slots=True, eq=False)
class Camera(Locked):
    """Intrinsics: q = K lens(p), with q = (column, row) px and (0, 0) the centre of the top-left pixel.

    size: (width, height) in px. K: [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] in px; skew is the entry K01.
    In the thesis' terms fx = f p cos(beta), skew = f p sin(beta), fy = f, cx = V0, cy = U0.
    """

    size: tuple[int, int]
    K: Array
    lens: Lens = field(default_factory=Ideal)

    def __post_init__(self) -> None:
        expect(self.lens, "lens", Lens)
        object.__setattr__(self, "size", checked_size(self.size))
        K = frozen(self.K, "K", (3, 3))
        if K[1, 0] or K[2, 0] or K[2, 1] or K[2, 2] != 1:
            raise BadValue("K", K.tolist(), "an upper triangle with K[2,2] = 1")
        if not (K[0, 0] > 0 and K[1, 1] > 0):
            raise BadValue("focal lengths (fx, fy)", (float(K[0, 0]), float(K[1, 1])), "two positive numbers, px")
        object.__setattr__(self, "K", K)

    @classmethod
    def from_focal(
        cls,
        size: tuple[int, int],
        fx: float,
        *,
        fy: float | None = None,
        cx: float | None = None,
        cy: float | None = None,
        skew: float = 0.0,
        lens: Lens | None = None,
    ) -> Camera:
        """Return the camera with these intrinsics in px; fy defaults to fx, the principal point to the centre."""
        width, height = checked_size(size)
        for what, value in (("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy), ("skew", skew)):
            if value is not None:
                expect_number(value, what)
        K = np.array(
            [
                [fx, skew, (width - 1) / 2 if cx is None else cx],
                [0.0, fx if fy is None else fy, (height - 1) / 2 if cy is None else cy],
                [0.0, 0.0, 1.0],
            ]
        )
        return cls((width, height), K, Ideal() if lens is None else lens)

    @classmethod
    def from_opencv(cls, size: tuple[int, int], matrix: Floats, coefficients: Floats | None = ()) -> Camera:
        """Return the camera of OpenCV's camera matrix and distortion vector (0, 4, 5, 8, 12 or 14 numbers, or None)."""
        coefficients = () if coefficients is None else coefficients
        return cls(size, frozen(matrix, "camera matrix", (3, 3)), lens_from_opencv(coefficients))

    @property
    def width(self) -> int:
        """Return the picture's width in px."""
        return self.size[0]

    @property
    def height(self) -> int:
        """Return the picture's height in px."""
        return self.size[1]

    @property
    def fx(self) -> float:
        """Return K00: px along x per unit of m."""
        return float(self.K[0, 0])

    @property
    def fy(self) -> float:
        """Return K11: px along y per unit of m; the thesis' focal length."""
        return float(self.K[1, 1])

    @property
    def skew(self) -> float:
        """Return K01 in px; zero for perpendicular image axes."""
        return float(self.K[0, 1])

    @property
    def principal_point(self) -> Array:
        """Return (cx, cy) in px."""
        return self.K[:2, 2]

    def project(self, p: Floats) -> Array:
        """Return pixels q (..., 2) of points p (..., 3) in the camera frame, mm.

        NaN for z <= 0 and outside the lens' valid radius; points outside the picture get their coordinates.
        """
        return self.pixel_of(self.lens.project(coordinates(p, "points", 3)))

    def project_with_jacobian(self, p: Floats) -> tuple[Array, Array]:
        """Return q (..., 2) and dq/dp (..., 2, 3) in px/mm."""
        m, dm_dp, _ = self.lens.project_with_jacobians(coordinates(p, "points", 3), ())
        return self.pixel_of(m), np.asarray(self.K[:2, :2] @ dm_dp)

    def unproject(self, q: Floats) -> Array:
        """Return unit directions (..., 3) in the camera frame of pixels q (..., 2); NaN where the lens images none."""
        return self.lens.unproject(self.normalized(q))

    def pixel_of(self, m: Array) -> Array:
        """Return q (..., 2) px of points m (..., 2) of the normalised (distorted) image plane."""
        return np.asarray(m @ self.K[:2, :2].T + self.K[:2, 2])

    def normalized(self, q: Floats) -> Array:
        """Return m (..., 2), the normalised (distorted) image plane's point of pixels q."""
        centred = coordinates(q, "pixels", 2) - self.K[:2, 2]
        y = centred[..., 1] / self.fy
        return np.stack([(centred[..., 0] - self.skew * y) / self.fx, y], axis=-1)

    def undistorted(self, q: Floats) -> Array:
        """Return the pixels of q (..., 2) in a camera of this K without distortion; NaN where the lens images none."""
        d = self.unproject(q)
        return self.pixel_of(d[..., :2] / np.where(d[..., 2:] > 0, d[..., 2:], np.nan))

    def undistorted_with_jacobian(self, q: Floats) -> tuple[Array, Array]:
        """Return the pixels (..., 2) of `undistorted` and their derivatives (..., 2, 2) by q; NaN as there."""
        d = self.unproject(q)
        u = d / np.where(d[..., 2:] > 0, d[..., 2:], np.nan)
        _, J = self.project_with_jacobian(u)
        known: Mask = np.asarray(np.isfinite(J).all(axis=(-2, -1), keepdims=True))
        back = np.linalg.inv(np.where(known, J[..., :2], np.eye(2)))  # u by q: the third coordinate stays 1
        return self.pixel_of(u[..., :2]), np.where(known, self.K[:2, :2] @ back, np.nan)

    def distorted(self, q: Floats) -> Array:
        """Return the inverse of `undistorted`: pixels in this camera of q (..., 2) in one without distortion."""
        m = self.normalized(q)
        return self.project(np.concatenate([m, np.ones((*m.shape[:-1], 1))], axis=-1))

    def sees(self, q: Floats) -> Mask:
        """Return which pixels q (..., 2) lie in the picture, [-1/2, W - 1/2] x [-1/2, H - 1/2]."""
        q = coordinates(q, "pixels", 2)
        inside = (q >= -0.5) & (q <= np.array([self.width - 0.5, self.height - 0.5]))
        return np.asarray(inside.all(axis=-1))

    def pixel_grid(self) -> Array:
        """Return the centre (x, y) of every pixel, (H, W, 2)."""
        x, y = np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64))
        return np.stack([x, y], axis=-1)

    def crop(self, x: int, y: int, size: tuple[int, int]) -> Camera:
        """Return the camera of the picture cut to `size` with pixel (x, y) as its new (0, 0)."""
        expect_number(x, "x of the cut")
        expect_number(y, "y of the cut")
        K = self.K.copy()
        K[:2, 2] -= (x, y)
        return replace(self, size=size, K=K)

    def resize(self, size: tuple[int, int]) -> Camera:
        """Return the camera of the picture resampled to `size`: q' = s (q + 1/2) - 1/2 along each axis."""
        width, height = checked_size(size)
        sx, sy = width / self.width, height / self.height
        H = np.array([[sx, 0.0, (sx - 1) / 2], [0.0, sy, (sy - 1) / 2], [0.0, 0.0, 1.0]])
        return replace(self, size=(width, height), K=H @ self.K)

    def __repr__(self) -> str:
        cx, cy = self.principal_point
        text = f"Camera({self.width} x {self.height} px, fx {self.fx:.6g}, fy {self.fy:.6g}, cx {cx:.6g}, cy {cy:.6g}"
        return text + (f", skew {self.skew:.4g}" if self.skew else "") + f" px, {self.lens})"


def checked_size(size: Any) -> tuple[int, int]:
    """Return (width, height) of a picture in px; `BadValue` for what is no size."""
    try:
        width, height = size
        whole = int(width) == width and int(height) == height
    except (TypeError, ValueError, OverflowError):
        raise BadValue("picture size", size, "(width, height) in px") from None
    if not whole or width < 1 or height < 1:
        raise BadValue("picture size", (width, height), "two whole numbers of at least 1 px")
    return int(width), int(height)
