"""Further evidence of a part's pose: points, lines or poses known by other means than its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Brief, frozen
from cadcam.camera.sensitivity import project_with_sensitivity
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid, by_twist, expect_motion
from cadcam.kinds import expect_count, expect_positive
from cadcam.locate.photo import Photo

NEVER_FREE = 1e-13  # share of the largest variance, up to which it may be rounding: that direction was not free
_ROUNDING = 1e-6  # of the largest variance: by how much those of a covariance may differ from it, or be below zero


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
        object.__setattr__(self, "photo", _checked(self.sigma_px, self.photo))

    def rows(self, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
        """Return photo minus model (2N,) px and its Jacobian (2N, 6) by the pose's own twist."""
        q, J = _projected(self.p, photo, world_from_part)
        return (self.q - q).ravel(), J.reshape(-1, 6)

    def by_camera(self, photo: Photo, world_from_part: Rigid) -> Array:
        """Return by how much the model's coordinates move with the camera's own (2N, c) (`camera.sensitivity`)."""
        J = _by_camera(self.p, photo, world_from_part)
        return J.reshape(-1, J.shape[-1])

    def reduced(self, times: int) -> PointEvidence:
        """Return it in pixels of its photo made so many times smaller (`Photo.reduced`)."""
        return replace(self, q=_in_reduced(self.q, times), sigma_px=self.sigma_px / times)


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
        if (self.p[0] == self.p[1]).all():
            raise BadValue("points of the edge", f"{self.p[0].tolist()}, twice", "two points of a straight edge")
        object.__setattr__(self, "photo", _checked(self.sigma_px, self.photo))

    def rows(self, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
        """Return the distances (N,) px of the pixels from the model's line and their Jacobian (N, 6)."""
        ends, J = _projected(self.p, photo, world_from_part)
        normal, t = self._across(ends)
        return (self.q - ends[0]) @ normal, (1 - t) * (normal @ J[0]) + t * (normal @ J[1])

    def by_camera(self, photo: Photo, world_from_part: Rigid) -> Array:
        """Return by how much the model's line moves with the camera's own coordinates (N, c) (`camera.sensitivity`)."""
        normal, t = self._across(_projected(self.p, photo, world_from_part)[0])
        J = _by_camera(self.p, photo, world_from_part)
        return np.asarray((1 - t) * (normal @ J[0]) + t * (normal @ J[1]))

    def reduced(self, times: int) -> LineEvidence:
        """Return it in pixels of its photo made so many times smaller (`Photo.reduced`)."""
        return replace(self, q=_in_reduced(self.q, times), sigma_px=self.sigma_px / times)

    def _across(self, ends: Array) -> tuple[Array, Array]:
        """Return the normal (2,) of the line between its imaged ends (2, 2), and where along it the pixels are (N, 1).

        nan where the ends are seen as one point: a line towards the camera.
        """
        along = ends[1] - ends[0]
        length = float(np.hypot(*along)) or float("nan")
        return np.array([-along[1], along[0]]) / length, ((self.q - ends[0]) @ along / length**2)[:, None]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PoseEvidence(Brief):
    """A pose world_from_part known by other means, with covariance (6, 6) in part axes, zero along directions not free.

    The covariance is of xi in world_from_part @ Rigid.exp(xi), mm and rad, and of errors that the photos do not share.
    radius (mm): of the part; it makes rotations comparable with translations. photo: not used. from_calibration (6, 6):
    covariance of what the errors of the photos' own cameras do to it, where it was measured with these; it counts in
    addition, and does not weigh.
    """

    world_from_part: Rigid
    covariance: Array
    radius: float
    photo: int = 0
    from_calibration: Array = field(default_factory=lambda: np.zeros((6, 6)))

    def __post_init__(self) -> None:
        expect_motion(self.world_from_part, "pose of the evidence")
        expect_positive(self.radius, "radius of the part", "a positive number of mm")
        for name in ("covariance", "from_calibration"):
            what = f"{name} of the pose"
            S = frozen(getattr(self, name), what, (6, 6))
            object.__setattr__(self, name, S)
            S = S * np.outer(*2 * [np.repeat([1.0, self.radius], 3)])
            if max(np.abs(S - S.T).max(), -np.linalg.eigvalsh(S)[0]) > _ROUNDING * np.abs(S).max():
                raise BadValue(what, "none", "a symmetric matrix without negative variances, in mm and rad")
        if not self.covariance.any():
            raise BadValue("covariance of the pose", "zero", "how uncertain it is, in mm and rad")
        object.__setattr__(self, "photo", _checked(self.sigma_px, self.photo))

    def rows(self, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
        """Return the difference in its own standard deviations, (k,) along its free directions, and the Jacobian."""
        scale = np.repeat([1.0, self.radius], 3)
        values, axes = np.linalg.eigh(scale[:, None] * self.covariance * scale)
        free = values > NEVER_FREE * values[-1]
        rows = (axes[:, free] / np.sqrt(values[free])).T * scale
        return rows @ (world_from_part.inv @ self.world_from_part).log(), rows

    def by_camera(self, photo: Photo, world_from_part: Rigid) -> Array:
        """Return zeros (k, c): no camera has a part in it."""
        c = _by_camera(np.zeros((0, 3)), photo, world_from_part).shape[-1]
        return np.zeros((len(self.rows(photo, world_from_part)[0]), c))

    def reduced(self, times: int) -> PoseEvidence:
        """Return itself: it has no pixels."""
        return self

    @property
    def sigma_px(self) -> float:
        """Return 1: its rows are in standard deviations."""
        return 1.0


Evidence = PointEvidence | LineEvidence | PoseEvidence


def rows_of(evidence: Sequence[Evidence], photos: Sequence[Photo], pose: Rigid) -> tuple[Array, Array, Array]:
    """Return offsets (m,), Jacobian (m, 6), variances (m,) px^2 of all evidence; nan where it is unseen.

    Raises `BadValue` for evidence of a photo that there is not.
    """
    y, J, variance = [np.zeros(0)], [np.zeros((0, 6))], [np.zeros(0)]
    for item in evidence:
        if not 0 <= item.photo < len(photos):
            raise BadValue("photo of the evidence", item.photo, f"a number from 0 to {len(photos) - 1}")
        offset, rows = item.rows(photos[item.photo], pose)
        y.append(offset)
        J.append(rows)
        variance.append(np.full(len(offset), item.sigma_px**2))
    return np.concatenate(y), np.concatenate(J), np.concatenate(variance)


def moved_by_cameras(evidence: Sequence[Evidence], photos: Sequence[Photo], pose: Rigid, gain: Array) -> list[Array]:
    """Return the derivative (6, c) of a twist by the own coordinates of each photo's camera, through evidence alone.

    gain (6, m): the derivative of the twist by the rows of `rows_of`.
    """
    out = [np.zeros((6, _by_camera(np.zeros((0, 3)), photo, pose).shape[-1])) for photo in photos]
    begin = 0
    for item in evidence:
        moved = item.by_camera(photos[item.photo], pose)
        out[item.photo] += gain[:, begin : begin + len(moved)] @ moved
        begin += len(moved)
    return out


def _in_reduced(q: Array, times: int) -> Array:
    return (q + 0.5) / times - 0.5


def _projected(p: Array, photo: Photo, world_from_part: Rigid) -> tuple[Array, Array]:
    camera_from_part = photo.camera_from_world @ world_from_part
    q, J = photo.camera.project_with_jacobian(camera_from_part @ p)
    return q, by_twist(p[:, None], J @ camera_from_part.rotation)


def _by_camera(p: Array, photo: Photo, world_from_part: Rigid) -> Array:
    """Return the derivative (N, 2, c) of the pixels of the part's points by their camera's own coordinates."""
    return project_with_sensitivity(photo.camera, photo.camera_from_world, world_from_part @ p)[1]


def _checked(sigma_px: object, photo: int) -> int:
    """Return the number of the photo; raise `BadValue` for one, or a sigma_px, that makes no sense."""
    expect_positive(sigma_px, "sigma_px of the evidence", "a positive number of px")
    expect_count(photo, "photo of the evidence", least=0, expected="the number of a photo, from 0")
    return int(photo)
