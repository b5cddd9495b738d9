"""Cameras of the lower dimensions from points: a plane's 3x3 matrix (2D to 2D), a line camera's five (2D to 1D).

Both start from the normalised direct linear transform and end at the least sum of squared image residuals, to which
their covariance refers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.line_camera import LINE_NAMES, LineCamera, LineEstimate, LineObservations
from cadcam.camera.measurement import Measurement, PixelNoise
from cadcam.camera.observations import Observations
from cadcam.camera.plane_camera import PlaneCamera, PlaneEstimate
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints
from cadcam.fit.dlt import dlt
from cadcam.fit.least_squares import cofactor, minimise
from cadcam.kinds import expect, expect_positive

_FAR = 1e6  # of their extent: rounding is its square times 2e-16 of the variances, which some tens of terms cancel to
_ONE_HEIGHT = 1e-6  # range of Z over the plane's size: 1 um over a metre


def calibrate_plane(observations: Observations) -> PlaneEstimate:
    """Return the map of the plane Z = constant of the world to the picture, from at least four points, with covariance.

    Raises `TooFewPoints`; `DegenerateGeometry` for points at different heights, with all but one of them on a line, or
    a million times farther from the origin than from each other.
    """
    expect(observations, "observations", Observations)
    p, q = observations.p_world[:, :2], observations.q
    if not len(p):  # of none there is no extent; `dlt` counts the others
        raise TooFewPoints("the calibration of a plane", 0, 4)
    spread, size = float(np.ptp(observations.p_world[:, 2])), float(np.ptp(p, axis=0).max())
    if spread > _ONE_HEIGHT * size:
        raise DegenerateGeometry(
            f"the points' Z differ by {spread:.4g} mm over {size:.4g} mm of the plane: a 3x3 matrix holds for one "
            "height; give points of one Z, or calibrate a camera in space"
        )
    away = float(np.linalg.norm(p.mean(axis=0)))
    if away > _FAR * size > 0:
        raise DegenerateGeometry(
            f"the points lie {away:.4g} mm from the origin of X and Y, and only {size:.4g} mm apart: of the matrix' "
            "covariance rounding would leave nothing; take an origin near them"
        )
    seed = PlaneCamera(dlt(p, q)).facing(p)
    problem = _PlaneProblem(p, q)
    found = minimise(problem, seed.matrix / np.linalg.norm(seed.matrix))
    basis = problem.basis(found.state)
    names = tuple(f"direction {i} of the matrix" for i in range(1, 9))
    return PlaneEstimate(
        PlaneCamera(found.state),
        observations,
        float(observations.p_world[:, 2].mean()),
        basis @ cofactor(found.jacobian, names) @ basis.T,
        "plane to picture, reprojection least squares",
    )


def calibrate_line(observations: LineObservations) -> LineEstimate:
    """Return the line camera from points of its plane and their images, from at least five points, with covariance.

    Raises `TooFewPoints`; `DegenerateGeometry` for points on a line, or on a conic through the focal centre.
    """
    expect(observations, "observations", LineObservations)
    p, U = observations.p_world, observations.U
    seed = LineCamera.from_matrix(dlt(p, U[:, None])).facing(p)
    found = minimise(_LineProblem(p, U), seed.vector)
    return LineEstimate(
        LineCamera.from_vector(found.state).facing(p),
        observations,
        cofactor(found.jacobian, LINE_NAMES),
        "line camera, reprojection least squares",
    )


def measure_on_plane(
    estimate: PlaneEstimate, q: Floats, *, names: Sequence[str] = (), sigma_px: float | None = None
) -> Measurement:
    """Return the points of the plane seen at pixels q (N, 2), in the world of the calibration (EQ 6.8-6.10).

    sigma_px: noise of these pixels, by default that of the calibration. The matrix' error is shared by all points.
    Points beyond the plane's vanishing line are refused individually; raises `DegenerateGeometry` if all of them are.
    """
    pixels = frozen(q, "pixels", (None, 2))
    names = tuple(names) or tuple(str(i + 1) for i in range(len(pixels)))
    if len(names) != len(pixels):
        raise BadValue("number of names", len(names), f"one for each of {len(pixels)} pixels")
    noise_px = _pixel_noise(estimate, sigma_px)
    p = estimate.camera.unproject(pixels)
    kept = np.asarray(np.isfinite(p).all(axis=1))
    if not kept.any():
        raise DegenerateGeometry(f"none of {len(p)} pixels shows the plane: they lie beyond its vanishing line")
    _, px_by_point, px_by_entry = estimate.camera.project_with_jacobians(p[kept])
    point_by_px = np.eye(3)[:, :2] @ np.linalg.inv(px_by_point)  # in space: no height over the plane
    covariance = noise_px**2 * point_by_px @ np.swapaxes(point_by_px, -1, -2)
    dof = estimate.noise_dof
    noise = PixelNoise(covariance, estimate, dof) if sigma_px is None else PixelNoise(covariance, None, np.inf)
    nothing = np.full(int(kept.sum()), np.nan)
    return Measurement(
        names=tuple(n for n, k in zip(names, kept, strict=True) if k),
        points=np.column_stack([p[kept], np.full(len(nothing), estimate.height)]),
        noise=(noise,),
        effects=((ErrorSource("calibration", estimate.covariance, estimate, dof), -point_by_px @ px_by_entry),),
        seen_by=(("plane",),) * len(nothing),
        chi2=np.zeros(len(nothing)),
        dof=np.zeros(len(nothing), dtype=np.int32),
        gap=nothing,
        gap_sigma=nothing,
        angle=nothing,
        refused={n: "beyond the plane's vanishing line" for n, k in zip(names, kept, strict=True) if not k},
        method="the plane's 3x3 matrix",
    )


def _pixel_noise(estimate: PlaneEstimate, sigma_px: float | None) -> float:
    """Return the standard deviation (px) of a pixel coordinate: as stated, or that of the calibration."""
    noise_px = estimate.noise_px if sigma_px is None else sigma_px
    if not np.isfinite(estimate.noise_px):
        raise BadValue("pixel noise of the calibration", "unknown", "five points or more, or sigma_px stated with them")
    expect_positive(noise_px, "sigma_px", "a positive number of px")
    return noise_px


@dataclass(frozen=True, slots=True, eq=False)
class _PlaneProblem:
    """States are matrices from plane (mm) to picture (px), of norm 1."""

    p: Array
    q: Array

    def residuals_and_jacobian(self, state: Array) -> tuple[Array, Array]:
        q, _, by_entry = PlaneCamera(state).project_with_jacobians(self.p)
        return (q - self.q).ravel(), by_entry.reshape(-1, 9) @ self.basis(state)

    def retract(self, state: Array, step: Array) -> Array:
        moved = state + (self.basis(state) @ step).reshape(3, 3)
        return np.asarray(moved / np.linalg.norm(moved))

    def basis(self, state: Array) -> Array:
        """Return (9, 8): steps of the entries that change the image, each by about the same amount."""
        to_plane, to_picture = _about_one(self.p), _about_one(self.q)
        similar = to_picture @ state @ np.linalg.inv(to_plane)
        tangent = np.linalg.svd(similar.reshape(1, 9))[2][1:].T * np.linalg.norm(similar)
        return np.asarray(np.kron(np.linalg.inv(to_picture), to_plane.T) @ tangent)


@dataclass(frozen=True, slots=True, eq=False)
class _LineProblem:
    p: Array
    U: Array

    def residuals_and_jacobian(self, state: Array) -> tuple[Array, Array]:
        if not np.isfinite(state).all() or state[3] == 0:
            return np.full(len(self.U), np.nan), np.full((len(self.U), 5), np.nan)
        U, _, J = LineCamera.from_vector(state).project_with_jacobians(self.p)
        return U - self.U, J

    def retract(self, state: Array, step: Array) -> Array:
        return state + step


def _about_one(x: Array) -> Array:
    """Return the homogeneous matrix (3, 3) that moves the centroid of x (N, 2) to 0 and its rms extent to 1."""
    centre = x.mean(axis=0)
    scale = np.sqrt(len(x)) / np.linalg.norm(x - centre)
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])
