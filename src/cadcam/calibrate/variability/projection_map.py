"""The uncertainty of a calibrated camera's projections over its picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.camera.estimate import CameraEstimate
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.kinds import expect, expect_count, expect_positive

NODES = 65  # along the longer side of the picture


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ProjectionMap(Brief):
    """Standard deviations sigma (h, w) px of projections at the pixels (x[j], y[i]), due to the camera's error alone.

    sigma is that along the worst direction: the root of the covariance's larger eigenvalue. NaN where the camera images
    no point of the surface. surface: description of where the points lie. q: the pixels (N, 2) of the calibration's
    points.
    """

    x: Array
    y: Array
    sigma: Array
    surface: str
    q: Array

    def __post_init__(self) -> None:
        for name, shape in (("x", (None,)), ("y", (None,)), ("sigma", (None, None)), ("q", (None, 2))):
            object.__setattr__(self, name, frozen(getattr(self, name), name, shape, finite=False))


def projection_map(
    estimate: CameraEstimate, *, depth_mm: float | None = None, plane: Floats | None = None, nodes: int = NODES
) -> ProjectionMap:
    """Return the uncertainty of projections over the picture, for points of a surface in front of the camera.

    depth_mm: points at this depth along the optical axis (default: the mean depth of the calibration's points). plane:
    (nx, ny, nz, d) instead, those with n . p_world = d mm, n of any length. nodes: along the picture's longer side.
    Raises `BadValue` for a depth that is not positive or both, `DegenerateGeometry` for a plane out of sight.
    """
    expect(estimate, "estimate", CameraEstimate)
    if depth_mm is not None and plane is not None:
        raise BadValue("surface", "a depth and a plane", "one of them")
    expect_count(nodes, "nodes", least=2)
    camera = estimate.camera
    h, w = (max(2, round(int(nodes) * n / max(camera.size))) for n in (camera.height, camera.width))
    x, y = np.linspace(-0.5, camera.width - 0.5, w), np.linspace(-0.5, camera.height - 0.5, h)
    rays = camera.unproject(np.stack(np.meshgrid(x, y), axis=-1))
    if plane is None:
        p_camera, surface = _at_depth(estimate, rays, depth_mm)
    else:
        p_camera, surface = _on_plane(estimate, rays, frozen(plane, "plane (nx, ny, nz, d)", (4,)))
    covariance = estimate.projection_covariance(estimate.camera_from_world.inv @ p_camera)
    return ProjectionMap(x, y, _worst_sigma(covariance), surface, estimate.observations.q)


def _at_depth(estimate: CameraEstimate, rays: Array, depth_mm: float | None) -> tuple[Array, str]:
    p = estimate.camera_from_world @ estimate.observations.p_world
    depth = p[:, 2].mean() if depth_mm is None else depth_mm
    expect_positive(depth, "depth_mm", "a positive distance along the optical axis")
    return rays * (depth / rays[..., 2:]), f"at {depth:.4g} mm along the optical axis"


def _on_plane(estimate: CameraEstimate, rays: Array, plane: Array) -> tuple[Array, str]:
    length = float(np.linalg.norm(plane[:3]))
    if length == 0:
        raise BadValue("plane (nx, ny, nz, d)", plane.tolist(), "a normal that is not zero")
    n, d = plane[:3] / length, plane[3] / length
    pose = estimate.camera_from_world
    along = rays @ (pose.rotation @ n)
    t = (d - n @ pose.origin) / np.where(along == 0, np.nan, along)
    t = np.where(t > 0, t, np.nan)
    text = f"on the plane {n[0]:.3g} X {n[1]:+.3g} Y {n[2]:+.3g} Z = {d:.4g} mm"
    if not np.isfinite(t).any():
        raise DegenerateGeometry(f"the camera sees nothing {text}: it lies behind it or beside its picture")
    return rays * t[..., None], text


def _worst_sigma(covariance: Array) -> Array:
    """Return the root of the larger eigenvalue (...) of covariances (..., 2, 2), in closed form."""
    a, b, c = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    return np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b))
