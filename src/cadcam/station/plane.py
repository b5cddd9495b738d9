"""One calibration position: how the camera sees the floor around it, from one picture of a plate.

The floor is described relative to the position that the controller states for the camera: H maps p - position to
pixels. If the camera were carried perfectly, H would be the same everywhere; its differences are the mechanics' errors.
Source: "Industrial Vision" (1997), sections 6.3.2, 6.3.4, EQ 6.2-6.10, program calib.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.calibrate.points.flat import calibrate_plane
from cadcam.camera.camera import Camera
from cadcam.camera.observations import Observations
from cadcam.camera.plane_camera import PlaneCamera, PlaneEstimate
from cadcam.errors import DegenerateGeometry
from cadcam.kinds import expect, expect_positive
from cadcam.station.plate import Placement

_STEP = 1e-30  # step of complex-step derivatives, which have no cancellation


@dataclass(frozen=True, slots=True, eq=False)
class LocalScale:
    """The size of one pixel at a point of the plane: mm per pixel along x and y, their ratio, and the skew.

    skew: by how much the images of the x and y axes are not perpendicular, pi/2 less the angle between
    them, rad. covariance (4, 4): of scale_x, scale_y, aspect, skew in this order.
    """

    scale_x: float
    scale_y: float
    skew: float
    covariance: Array

    @property
    def aspect(self) -> float:
        """Return scale_x / scale_y."""
        return self.scale_x / self.scale_y


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlaneCalibration(Brief):
    """The calibration at one position (x, y) of the controller, mm.

    placement: where the plate lay. estimate: the camera of the plane relative to `position`, with its covariance from
    the pixels, distortion removed. seen: which of the plate's marks were found. name: of the picture. lens: whose
    distortion was removed; None where the matrix is the whole model. sigma_px: noise of one coordinate of the pixels as
    found, as stated, or None. stretch: by how much that noise grows as the distortion is removed, rms over the marks.
    """

    name: str
    position: Array
    placement: Placement
    estimate: PlaneEstimate
    seen: tuple[int, ...]
    lens: Camera | None = None
    sigma_px: float | None = None
    stretch: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen(self.position, "calibration position", (2,)))

    @property
    def camera(self) -> PlaneCamera:
        """Return the camera of the plane relative to the position."""
        return self.estimate.camera

    @property
    def world_camera(self) -> PlaneCamera:
        """Return the camera of the plane in world coordinates, while at this position (program calib's C)."""
        away = np.eye(3)
        away[:2, 2] = -self.position
        return PlaneCamera(self.camera.matrix @ away)

    @property
    def centre(self) -> Array:
        """Return the mean (2,) of the plate's marks, relative to the position, mm."""
        return np.asarray(self.estimate.observations.p_world[:, :2].mean(axis=0))

    @property
    def scale(self) -> LocalScale:
        """Return the size of a pixel at the centre of the plate."""
        return local_scale(self.estimate, self.centre)

    @property
    def pixels(self) -> Array:
        """Return the pixels (N, 2) of the seen marks, as found."""
        q = self.estimate.observations.q
        return q if self.lens is None else self.lens.distorted(q)

    @property
    def noise_px(self) -> float:
        """Return the noise of one coordinate of the pixels as found: as stated, else by the residuals, else inf."""
        return self.estimate.noise_px / self.stretch

    def straight(self, q: Floats) -> Array:
        """Return pixels (N, 2) with the lens' distortion removed, as `camera` takes them."""
        return np.asarray(q, dtype=np.float64) if self.lens is None else self.lens.undistorted(q)

    def predict(self, q: Floats, position: Floats) -> Array:
        """Return the world points (N, 2) mm of undistorted pixels (N, 2), seen at the controller's `position` (2,).

        Assumes perfect mechanics between the two positions: p = H^-1 q + position (6.4.3.5, program perspec).
        """
        return np.asarray(self.camera.unproject(q) + np.asarray(position, dtype=np.float64))

    def by_entries(self, p: Floats) -> tuple[Array, Array]:
        """Return the Jacobians of points p (N, 2), relative, by their pixels (N, 2, 2) and by H's entries (N, 2, 9)."""
        _, by_point, by_entry = self.camera.project_with_jacobians(p)
        back = np.asarray(np.linalg.inv(by_point), dtype=np.float64)
        return back, -back @ by_entry

    @property
    def by_marks(self) -> Array:
        """Return the Jacobian (9, 2 K) of H's entries by the world places of the seen marks."""
        p = self.estimate.observations.p_world[:, :2]
        _, by_point, by_entry = self.camera.project_with_jacobians(p)
        onto = self.estimate.cofactor @ by_entry.reshape(-1, 9).T  # least squares: entries by pixels
        return np.asarray(np.einsum("ekx,kxy->eky", onto.reshape(9, -1, 2), by_point).reshape(9, -1))


def calibrate_position(
    name: str,
    position: Floats,
    q: Floats,
    placement: Placement,
    *,
    sigma_px: float | None = None,
    lens: Camera | None = None,
    source: str = "memory",
    sha256: str = "",
) -> PlaneCalibration:
    """Return the calibration of a position from the pixels (K, 2) of the plate's marks, in the plate's order.

    A mark that was not found has NaN as its pixel; at least four are needed. sigma_px: noise of one pixel coordinate,
    by default from the residuals. lens: a calibrated camera whose distortion is removed from the pixels (nothing else
    of it is used). Raises `TooFewPoints`, `DegenerateGeometry`.
    """
    expect(placement, "placement", Placement)
    expect(lens, "lens", Camera, optional=True)
    if sigma_px is not None:
        expect_positive(sigma_px, "sigma_px", "a positive number of px, or None")
    at, plate = frozen(position, "calibration position", (2,)), placement.plate
    pixels = frozen(q, "pixels of the marks", (len(plate.marks), 2), finite=False)
    seen = np.isfinite(pixels).all(axis=1)
    p = np.column_stack([placement.marks - at, np.zeros(len(pixels))])
    names = tuple(n for n, s in zip(plate.mark_names, seen, strict=True) if s)
    straight, stretch = pixels[seen], 1.0
    if lens is not None:
        straight, by_pixel = lens.undistorted_with_jacobian(pixels[seen])
        stretch = float(np.sqrt(np.mean(by_pixel**2) * 2)) if len(straight) else 1.0
    noise = None if sigma_px is None else sigma_px * stretch
    observations = Observations(p[seen], straight, names, noise, source, sha256)
    found = tuple(np.flatnonzero(seen).tolist())
    return PlaneCalibration(name, at, placement, calibrate_plane(observations), found, lens, sigma_px, stretch)


def refuse_misfit(calibration: PlaneCalibration, *, limit_px: float) -> None:
    """Raise `DegenerateGeometry` where the marks do not fit a plane seen by a camera: wrong plate or order."""
    residual = calibration.estimate.thesis_residual
    if residual > limit_px:
        worst = int(np.argmax(np.linalg.norm(calibration.estimate.residuals, axis=1)))
        raise DegenerateGeometry(
            f"the marks in {calibration.name} do not fit the plate: residual {residual:.2f} px, {limit_px:g} allowed; "
            f"the worst is mark {calibration.estimate.observations.names[worst]!r}. Is it this plate, and each mark "
            "in its place?"
        )


def local_scale(estimate: PlaneEstimate, p: Floats) -> LocalScale:
    """Return scales, aspect and skew of a plane's camera at the plane point p (2,), from the Jacobian there.

    The columns of the 3x3 matrix (section 6.3.4) give them only where its last row makes t = 1.
    """
    at, h = frozen(p, "plane point", (2,)), estimate.camera.matrix.ravel()
    values = _scales(h.astype(np.complex128), at).real
    J = np.stack([_scales(h + 1j * _STEP * e, at).imag / _STEP for e in np.eye(9)], axis=1)
    covariance = estimate.covariance
    known = J @ np.where(np.isfinite(covariance), covariance, 0.0) @ J.T
    total = known if np.isfinite(covariance).all() else np.diag(np.full(4, np.inf))
    return LocalScale(float(values[0]), float(values[1]), float(values[3]), np.asarray(total))


def _scales(h: npt.NDArray[np.complex128], p: Array) -> npt.NDArray[np.complex128]:
    """Return (scale x, scale y, aspect, skew) of complex matrix entries; analytic, for the complex step."""
    H = h.reshape(3, 3)
    u = H[:, :2] @ p + H[:, 2]
    J = (H[:2, :2] - np.outer(u[:2] / u[2], H[2, :2])) / u[2]
    nx, ny = np.sqrt(J[0, 0] ** 2 + J[1, 0] ** 2), np.sqrt(J[0, 1] ** 2 + J[1, 1] ** 2)
    dot, cross = J[0, 0] * J[0, 1] + J[1, 0] * J[1, 1], J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
    handed = np.sign(cross.real)
    return np.array([1 / nx, 1 / ny, ny / nx, np.arctan(dot / (handed * cross))])
