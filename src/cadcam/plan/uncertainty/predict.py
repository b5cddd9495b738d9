"""The uncertainty of points before they are measured: what `measure_points` would state for given viewpoints.

The same first-order propagation as `cadcam.calibrate.measure.intersect`, but no pixels are needed. The noise may differ
from point to point and between directions in the picture, because of blur and slant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, Ids, Mask, frozen
from cadcam.camera.error_source import ErrorSource, by_unit_errors, distinct_sources
from cadcam.camera.measurement import PIXELS
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue
from cadcam.geometry.plane import Plane
from cadcam.kinds import FrozenMap, expect, expect_each, expect_positive
from cadcam.plan.uncertainty.evidence import Evidence, symmetric, together

HEIGHT = "height of the plane"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Prediction(Brief):
    """Points (N, 3) mm and the covariance (N, 3, 3) mm^2 with which they would be measured, NaN where they cannot be.

    by_cause: the covariances that add up to it, by cause: pixels, each calibration, each motion, the plane's height.
    cameras (N,): how many viewpoints see each point.
    """

    points: Array
    covariance: Array
    by_cause: Mapping[str, Array]
    cameras: Ids

    def __post_init__(self) -> None:
        n = len(self.points)
        object.__setattr__(self, "points", frozen(self.points, "points", (None, 3)))
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariance", (n, 3, 3), finite=False))
        object.__setattr__(self, "by_cause", FrozenMap(self.by_cause))
        object.__setattr__(self, "cameras", frozen(self.cameras, "cameras", (n,), np.int32))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (N, 3) mm of X, Y, Z."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1)))

    @property
    def worst(self) -> Array:
        """Return the standard deviation (N,) mm along the direction in which each point is known worst."""
        known = np.asarray(np.isfinite(self.covariance).all(axis=(-2, -1)))
        w = np.linalg.eigvalsh(np.where(known[:, None, None], self.covariance, 0.0))[:, -1]
        return np.asarray(np.where(known, np.sqrt(np.maximum(w, 0.0)), np.nan))


def predict_points(
    viewpoints: Sequence[Viewpoint],
    p: Floats,
    *,
    noise: Floats | None = None,
    seen: Mask | None = None,
    plane: Plane | None = None,
    plane_sigma_mm: float = 0.0,
) -> Prediction:
    """Return how well points p (N, 3) mm will be measured from V viewpoints, or from one, on a known plane.

    noise (V, N, 2, 2) px^2: covariance of each point's pixels, such as `circle_covariance`; default sigma_px^2 of the
    viewpoint. seen (V, N): which viewpoint sees which point; default: where it lies in the picture. Nothing is hidden
    here: ask `cadcam.plan.sight.visibility`. plane, plane_sigma_mm: as in `measure_points`. Raises `BadValue`.
    """
    viewpoints = expect_each(viewpoints, "viewpoints", Viewpoint)
    points = frozen(p, "points", (None, 3))
    if not viewpoints:
        raise BadValue("viewpoints", "none", "at least one")
    expect_positive(plane_sigma_mm, "plane_sigma_mm", "a number of mm from 0 on", zero=True)
    expect(plane, "plane", Plane, optional=True)
    if plane is not None and not plane.single:
        raise BadValue("plane", repr(plane), "one plane for all points")
    q, J, effects = zip(*(view.project(points) for view in viewpoints), strict=True)
    shown = _shown(viewpoints, np.stack(q), seen)
    noise_inverse = np.asarray(np.linalg.inv(_noise(viewpoints, noise, len(points))))
    evidence = Evidence(np.stack(J), noise_inverse).where(shown)
    sources = sources_of(viewpoints)
    E, columns = shifts(viewpoints, effects, sources, len(points))
    E = np.where(shown[..., None, None], E, 0.0)
    height = _height_information(plane, plane_sigma_mm, len(points))
    exact = plane if plane_sigma_mm == 0 else None
    found = together(evidence, E, height, basis=None if exact is None else exact.basis)
    by_cause = _causes(sources, columns, found.by_number) | {PIXELS: found.from_pixels}
    if plane is not None and plane_sigma_mm > 0:
        by_cause[HEIGHT] = symmetric(found.covariance @ height @ found.covariance)
    cameras = shown.sum(axis=0, dtype=np.int32)
    enough = cameras >= (2 if plane is None else 1)
    covariance = np.where(enough[:, None, None], found.covariance, np.nan)
    return Prediction(points, covariance, by_cause, cameras)


def _height_information(plane: Plane | None, sigma_mm: float, n: int) -> Array:
    """Return what a plane known to sigma_mm adds to the information (n, 3, 3) of points; an exact one is no prior."""
    information = np.zeros((n, 3, 3))
    if plane is not None and sigma_mm > 0:
        information += np.outer(plane.normal, plane.normal) / sigma_mm**2
    return information


def shifts(
    viewpoints: Sequence[Viewpoint], effects: Sequence[tuple[Array, ...]], sources: Sequence[ErrorSource], n: int
) -> tuple[Array, list[slice]]:
    """Return by how much the sources' errors move the points' pixels, E (V, n, 2, P), and each source's columns in it.

    The P columns belong to independent errors of unit variance.
    """
    own = [[source for source, _ in view.errors] for view in viewpoints]
    each = [by_unit_errors(zip(s, D, strict=True), sources, (n, 2)) for s, D in zip(own, effects, strict=True)]
    return np.stack([E for E, _ in each]), each[0][1]


def _shown(viewpoints: Sequence[Viewpoint], q: Array, seen: Mask | None) -> Mask:
    """Return which viewpoint sees which point (V, N), imaged at q (V, N, 2): as stated, or wherever it can."""
    if seen is None:
        return np.stack([view.camera.sees(at) for view, at in zip(viewpoints, q, strict=True)])
    visible = frozen(seen, "seen", (None, None), bool)
    if visible.shape != q.shape[:2]:
        raise BadValue("seen", f"of shape {visible.shape}", f"({q.shape[0]} viewpoints, {q.shape[1]} points)")
    return np.asarray(visible & np.isfinite(q).all(axis=-1))


def _noise(viewpoints: Sequence[Viewpoint], noise: Floats | None, n: int) -> Array:
    if noise is None:
        own = np.array([view.sigma_px**2 for view in viewpoints])
        return np.asarray(own[:, None, None, None] * np.broadcast_to(np.eye(2), (len(viewpoints), n, 2, 2)))
    given = frozen(noise, "noise (viewpoints, points, 2, 2)", (len(viewpoints), n, 2, 2))
    none = np.argwhere(~(np.linalg.eigvalsh(given)[..., 0] > 0))
    if len(none):
        view, point = none[0].tolist()
        raise BadValue(f"noise{[view, point]}", given[view, point].tolist(), "a covariance of positive variances")
    return given


def sources_of(viewpoints: Sequence[Viewpoint]) -> list[ErrorSource]:
    """Return the error sources of the viewpoints, those of one owner once."""
    return distinct_sources([source for view in viewpoints for source, _ in view.errors])


def _causes(sources: Sequence[ErrorSource], columns: Sequence[slice], by_number: Array) -> dict[str, Array]:
    """Return the points' covariance (N, 3, 3) due to each source, those of one name added up."""
    out: dict[str, Array] = {}
    for source, own in zip(sources, columns, strict=True):
        G = by_number[..., own]
        out[source.name] = out.get(source.name, np.zeros((1, 3, 3))) + G @ np.swapaxes(G, -1, -2)
    return out
