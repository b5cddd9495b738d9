"""Further evidence of a part's pose: points, lines or poses known by other means than its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, frozen
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid, by_twist
from cadcam.kinds import expect_positive
from cadcam.locate.photo import Photo

_NEVER_FREE = 1e-9  # share of the largest variance below which a direction was not free


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointEvidence(Brief):
    """N points p (N, 3) mm of the part seen at q (N, 2) px in photo number `photo`, each coordinate to sigma_px."""

    p: Array
    q: Array
    sigma_px: float
    photo: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "p", frozen(self.p, "points of the part", (None, 3)))
        object.__setattr__(self, "q", frozen(self.q, "pixels of the points", (len(self.p), 2)))
        _positive(self.sigma_px)

    def rows(self, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
        """Return photo minus model (2N,) px and its Jacobian (2N, 6) by the pose's own twist."""
        q, J = _projected(self.p, photo, world_from_part)
        return (self.q - q).ravel(), J.reshape(-1, 6)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LineEvidence(Brief):
    """A straight edge of the part through p (2, 3) mm, seen to pass through q (N, 2) px, each to sigma_px across it.

    With lens distortion the points must be near the images of p: the line between these is treated as straight.
    """

    p: Array
    q: Array
    sigma_px: float
    photo: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "p", frozen(self.p, "points of the edge", (2, 3)))
        object.__setattr__(self, "q", frozen(self.q, "pixels on the edge", (None, 2)))
        _positive(self.sigma_px)

    def rows(self, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
        """Return the distances (N,) px of the pixels from the model's line and their Jacobian (N, 6)."""
        ends, J = _projected(self.p, photo, world_from_part)
        along = ends[1] - ends[0]
        length = float(np.hypot(*along))
        normal = np.array([-along[1], along[0]]) / length
        t = ((self.q - ends[0]) @ along / length**2)[:, None]
        return (self.q - ends[0]) @ normal, (1 - t) * (normal @ J[0]) + t * (normal @ J[1])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoseEvidence(Brief):
    """A pose world_from_part known by other means, with covariance (6, 6) in part axes, zero along directions not free.

    radius (mm): of the part; it makes rotations comparable with translations.
    """

    world_from_part: Rigid
    covariance: Array
    radius: float
    photo: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariance of the pose", (6, 6)))

    def rows(self, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
        """Return the difference in its own standard deviations, (k,) along its free directions, and the Jacobian."""
        scale = np.repeat([1.0, self.radius], 3)
        values, axes = np.linalg.eigh(scale[:, None] * self.covariance * scale)
        free = values > _NEVER_FREE * values[-1]
        rows = (axes[:, free] / np.sqrt(values[free])).T * scale
        return rows @ (world_from_part.inv @ self.world_from_part).log(), rows

    @property
    def sigma_px(self) -> float:
        """Return 1: its rows are in standard deviations."""
        return 1.0


Evidence = PointEvidence | LineEvidence | PoseEvidence


def rows_of(evidence: Sequence[Evidence], photos: Sequence[Photo], pose: Rigid) -> tuple[Array, Array, Array]:
    """Return offsets (m,), Jacobian (m, 6), variances (m,) px^2 of all evidence; nan where it is unseen."""
    y, J, variance = [np.zeros(0)], [np.zeros((0, 6))], [np.zeros(0)]
    for item in evidence:
        if not 0 <= item.photo < len(photos):
            raise BadValue("photo of the evidence", item.photo, f"a number from 0 to {len(photos) - 1}")
        offset, rows = item.rows(photos[item.photo], pose)
        y.append(offset)
        J.append(rows)
        variance.append(np.full(len(offset), item.sigma_px**2))
    return np.concatenate(y), np.concatenate(J), np.concatenate(variance)


def _projected(p: Array, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
    camera_from_part = photo.camera_from_world @ world_from_part
    q, J = photo.camera.project_with_jacobian(camera_from_part @ p)
    return q, by_twist(p[:, None], J @ camera_from_part.rotation)


def _positive(sigma_px: object) -> None:
    expect_positive(sigma_px, "sigma_px of the evidence", "a positive number of px")
