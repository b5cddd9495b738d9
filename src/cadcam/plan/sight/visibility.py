"""What one camera sees of all features in all poses of the part, and the information that its picture gives.

A feature is seen if it is in the picture, away from its border; faces the camera; is sharp and large enough; and is
not hidden by the part or by obstacles: a point as such, of a circle's rim or an edge's stations a sufficient share.
Rays are cast in the part's frame against the part and in the world against obstacles, so nothing is rebuilt per pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.camera.optics import Optics
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry.rigid import Rigid
from cadcam.plan.scene.layout_scene import Seeing
from cadcam.plan.sight.datum import DatumEvidence, Judging
from cadcam.plan.sight.places import Places
from cadcam.plan.sight.surroundings import Surroundings
from cadcam.plan.uncertainty.evidence import Evidence
from cadcam.plan.uncertainty.finding import (
    Finder,
    circle_covariance,
    defocus,
    edge_variance,
    half_axes,
    point_covariance,
)

Codes = npt.NDArray[np.int8]
_FLAT = 0.05  # px: a station's piece of edge is at least as long as this, unless it is seen end-on


class Why(IntEnum):
    """Why a camera does not see a feature; the first that applies."""

    SEEN = 0
    OUTSIDE = 1
    OBLIQUE = 2
    SMALL = 3
    BLURRED = 4
    HIDDEN = 5

    @property
    def words(self) -> str:
        """Return it in words."""
        return (
            "seen",
            "out of the picture",
            "seen too obliquely or from behind",
            "too small",
            "out of focus",
            "hidden",
        )[self]


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What a camera sees of F features in P poses.

    why (P, F): codes of `Why`; mm_per_px, incidence (rad; NaN without a normal), blur_px (diameter of the circle of
    confusion), distance (mm), sigma_px (of the place in the picture, worst direction), each (P, F). evidence: of the
    features' displacements in part axes, (P, F); turns: of straight edges' slopes, (P, F). shift, bend (P, F, 2, 2):
    covariance of the picture's shift by the camera's errors, px^2, and of its change along an edge, px^2/mm^2. datum:
    what is told of features that are judged relative to one.
    """

    why: Codes
    mm_per_px: Array
    incidence: Array
    blur_px: Array
    distance: Array
    sigma_px: Array
    evidence: Evidence
    turns: Evidence
    shift: Array
    bend: Array
    datum: DatumEvidence | None = None

    @property
    def seen(self) -> Mask:
        """Return which features are seen (P, F)."""
        return np.asarray(self.why == Why.SEEN)


def seen_from(
    viewpoint: Viewpoint,
    optics: Optics | None,
    places: Places,
    poses: Sequence[Rigid],
    surroundings: Surroundings,
    *,
    finder: Finder,
    seeing: Seeing,
    judging: Judging | None = None,
) -> Visibility:
    """Return what a camera sees of the features at some places of the part in some poses (world_from_part).

    judging: the features that are judged relative to a datum; of these any part of an edge that is seen counts.
    """
    view = _View(viewpoint, optics, places, poses, finder)
    share = _share_seen(view, surroundings, seeing)
    why = _why(view, share, seeing)
    datum = None
    if judging is not None:
        datum = judging.seen_from(viewpoint, optics, poses, surroundings, finder=finder, seeing=seeing)
        own = why[:, judging.numbers]
        own[own == Why.SEEN] = Why.SMALL
        why[:, judging.numbers] = np.where(datum.length_px >= max(seeing.least_px, 1.0), Why.SEEN, own)
    seen = why == Why.SEEN
    evidence, turns, sigma = _evidence(view, finder, seen, share.visible)
    J = view.J[:, view.central]
    return Visibility(
        why=why,
        mm_per_px=np.sqrt(2) / np.linalg.norm(J, axis=(-2, -1)),
        incidence=view.incidence,
        blur_px=view.defocus,
        distance=view.distance,
        sigma_px=np.where(seen, sigma, np.nan),
        evidence=evidence.where(seen),
        turns=turns.where(seen),
        shift=view.shift(),
        bend=view.bend(),
        datum=datum,
    )


def sees(
    viewpoint: Viewpoint,
    optics: Optics | None,
    places: Places,
    poses: Sequence[Rigid],
    surroundings: Surroundings,
    *,
    finder: Finder,
    seeing: Seeing,
) -> Mask:
    """Return which features (P, F) a camera sees, as `seen_from`, but not how well: a third of the time."""
    view = _View(viewpoint, optics, places, poses, finder)
    return np.asarray(_why(view, _share_seen(view, surroundings, seeing), seeing) == Why.SEEN)


class _View:
    """The places of F features as one camera images them in P poses of the part.

    Of each of all S places: q (P, S, 2) px, J (P, S, 2, 3) px/mm by the part's axes, border (P, S) px: distance inside
    of the picture's border, -inf where it is not imaged. Of each feature (P, F): distance (mm) from the camera and
    incidence (rad; NaN without a normal), defocus and blur (px; NaN behind the camera); A (P, F, 2, 2): the image of
    the unit circle in its own plane, or of its own circle. R (P, 3, 3), t (P, 3): world_from_part; eye (P, 3): the
    camera in the part frame; sharp: the blur in focus; central (F,): the place that stands for a feature.
    """

    def __init__(
        self,
        viewpoint: Viewpoint,
        optics: Optics | None,
        places: Places,
        poses: Sequence[Rigid],
        finder: Finder,
    ) -> None:
        self.viewpoint, self.optics, self.places = viewpoint, optics, places
        self.R = np.stack([pose.rotation for pose in poses])
        self.t = np.stack([pose.translation for pose in poses])
        self._first = np.flatnonzero(np.diff(places.feature, prepend=-1))
        self.central = self._central()
        self._image()
        self._slant()
        self._blur(finder)

    def _image(self) -> None:
        """Set what the camera's projection of the places gives."""
        camera, pose, places = self.viewpoint.camera, self.viewpoint.camera_from_world, self.places
        self.q, J = camera.project_with_jacobian(pose @ self.world(places.p))
        self.J = J @ pose.rotation @ self.R[:, None]
        inside = self.q + 0.5
        border = np.minimum(inside, np.array(camera.size) - inside).min(axis=-1)
        self.border = np.where(np.isfinite(border), border, -np.inf)
        radius = np.where(places.is_circle, places.diameter / 2, 1.0)
        self.A = self.J[:, self.central] @ (places.axes * radius[:, None, None])

    def _slant(self) -> None:
        """Set from where the camera looks at the features."""
        eye = self.viewpoint.camera_from_world.origin - self.t
        self.eye = np.einsum("pji,pj->pi", self.R, eye)  # in the part frame
        towards = self.eye[:, None] - self.places.centre
        self.distance = np.linalg.norm(towards, axis=-1)
        cosine = np.einsum("pfi,fi->pf", towards, self.places.normal) / self.distance
        self.incidence = np.arccos(np.clip(cosine, -1, 1))

    def _blur(self, finder: Finder) -> None:
        """Set how blurred the features are, by their depth."""
        z = (self.viewpoint.camera_from_world @ self.world(self.places.centre))[..., 2]
        z = np.where(z > 0, z, np.nan)
        self.defocus, self.blur = defocus(self.optics, z), finder.blur(self.optics, z)
        in_focus = 1.0 if self.optics is None else self.optics.distance_mm
        self.sharp = float(finder.blur(self.optics, in_focus))

    def world(self, p: Array) -> Array:
        """Return part points (n, 3) in the world (P, n, 3)."""
        return np.asarray(np.einsum("pij,nj->pni", self.R, p) + self.t[:, None])

    def shift(self) -> Array:
        """Return the covariance (P, F, 2, 2) px^2 of the picture's shift at each feature, by the camera's errors."""
        return self._squared(self._moves(self.places.centre), len(self.places.centre))

    def bend(self) -> Array:
        """Return the covariance (P, F, 2, 2) (px/mm)^2 of its change along straight edges; 0 elsewhere."""
        out = np.zeros((len(self.R), len(self.places.centre), 2, 2))
        straight = self.places.is_straight
        if straight.any():
            a, b = self.places.ends[straight, 0], self.places.ends[straight, 1]
            length = np.linalg.norm(b - a, axis=1)[:, None, None]
            pairs = zip(self._moves(a), self._moves(b), strict=True)
            out[:, straight] = self._squared([(v - u) / length for u, v in pairs], len(a))
        return out

    def _moves(self, p: Array) -> list[Array]:
        """Return the shift of part points' pixels by each error source of unit variance: (P, n, 2, k) each."""
        _, _, effects = self.viewpoint.project(self.world(p).reshape(-1, 3))
        sources = [source for source, _ in self.viewpoint.errors]
        roots = [np.nan_to_num(D @ source.root) for source, D in zip(sources, effects, strict=True)]
        return [E.reshape(len(self.R), len(p), 2, E.shape[-1]) for E in roots]

    def _squared(self, moves: list[Array], n: int) -> Array:
        """Return the sum (P, n, 2, 2) of their outer products; zero where there are none."""
        return np.asarray(sum((E @ np.swapaxes(E, -1, -2) for E in moves), np.zeros((len(self.R), n, 2, 2))))

    def sums(self, values: Array) -> Array:
        """Return the sums (P, F, ...) over each feature's places of values (P, S, ...)."""
        return np.asarray(np.add.reduceat(values, self._first, axis=1))

    def _central(self) -> npt.NDArray[np.int64]:
        """Return the place (F,) nearest to each feature's middle: where it is measured, or its middle station."""
        last = np.append(self._first[1:], len(self.places.feature)) - 1
        return np.where(self.places.is_edge, (self._first + last) // 2, last)


@dataclass(slots=True, eq=False)
class _Share:
    """Which places are visible and in the picture (P, S); by feature the shares (P, F) of such places."""

    visible: Mask
    seen: Array
    inside: Array


def _share_seen(view: _View, surroundings: Surroundings, seeing: Seeing) -> _Share:
    """Return which places are visible; rays are cast only to those that may be, as that takes most of the time."""
    places = view.places
    inside = view.border >= seeing.border_px
    sighted = np.broadcast_to(places.sighted, inside.shape)
    count = view.sums(sighted.astype(float))
    share_inside = view.sums((inside & sighted).astype(float)) / count
    facing = ~(view.incidence > seeing.incidence)  # NaN: any side
    ask = inside & sighted & facing[:, places.feature]
    pose, place = np.nonzero(ask)
    visible = np.zeros_like(ask)
    hidden = surroundings.hidden(view.R, view.t, view.eye, pose, places.p[place])
    visible[pose, place] = ~hidden
    return _Share(visible, view.sums(visible.astype(float)) / count, share_inside)


def _why(view: _View, share: _Share, seeing: Seeing) -> Codes:
    """Return the first reason (P, F) by which a feature is not seen, in the order of `Why`."""
    places = view.places
    needed = np.where(places.is_edge | places.is_circle, seeing.share, 1.0)
    inside_needed = np.where(places.is_edge, seeing.share, 1.0)
    small = np.zeros(share.seen.shape, bool)
    _, short = half_axes(view.A[:, places.is_circle])
    small[:, places.is_circle] = 2 * short < seeing.least_px
    length = view.sums(np.nan_to_num(np.linalg.norm(_along(view), axis=-1)) * share.visible)
    small[:, places.is_edge] = (length < seeing.least_px)[:, places.is_edge]
    tests: tuple[tuple[Why, Any], ...] = (
        (Why.HIDDEN, share.seen < needed - 1e-9),
        (Why.BLURRED, view.defocus > seeing.blur_px),
        (Why.SMALL, small & (share.seen >= needed - 1e-9)),
        (Why.OBLIQUE, view.incidence > seeing.incidence),
        (Why.OUTSIDE, share.inside < inside_needed - 1e-9),
    )
    why = np.zeros(share.seen.shape, np.int8)
    for code, applies in tests:  # from the last reason to the first, which remains
        why[applies] = code
    return why


def _along(view: _View) -> Array:
    """Return the picture (P, S, 2) px of each station's piece of edge; NaN elsewhere."""
    return np.asarray((view.J @ (view.places.tangent * view.places.length[:, None])[..., None])[..., 0])


def _evidence(view: _View, finder: Finder, seen: Mask, visible: Mask) -> tuple[Evidence, Evidence, Array]:
    """Return evidence of displacements and of slopes (P, F), and the worst sigma (P, F) px in the picture."""
    places, P, F = view.places, len(view.R), len(view.places.centre)
    W, slope, sigma = np.zeros((P, F, 2, 2)), np.zeros((P, F, 2, 2)), np.full((P, F), np.nan)
    marks, edges = ~places.is_edge, places.is_edge
    if marks.any():
        noise = _mark_noise(view, finder, marks)
        usable = seen[:, marks] & np.isfinite(noise).all(axis=(-2, -1))
        noise = np.where(usable[..., None, None], noise, np.eye(2))
        W[:, marks] = np.linalg.inv(noise)
        sigma[:, marks] = np.sqrt(np.linalg.eigvalsh(noise)[..., -1])
    if edges.any():
        along, across, own = _edges(view, finder, seen, visible)
        W[:, edges], slope[:, edges], sigma[:, edges] = along[:, edges], across[:, edges], own[:, edges]
    J = view.J[:, view.central]
    J = np.where(np.isfinite(J), J, 0.0)
    return Evidence(J, W), Evidence(J, slope), sigma


def _mark_noise(view: _View, finder: Finder, marks: Mask) -> Array:
    """Return the covariance (P, M, 2, 2) px^2 of points and circles."""
    places, blur = view.places, view.blur[:, marks]
    noise = np.full((*blur.shape, 2, 2), np.nan)
    faced = np.isfinite(places.normal[marks]).all(axis=1)
    sized = places.is_circle[marks]
    A = np.where(np.isfinite(view.A[:, marks]), view.A[:, marks], 1.0)
    for which, known in ((faced & sized, True), (faced & ~sized, False)):
        if which.any():
            noise[:, which] = circle_covariance(finder, A[:, which], blur[:, which], sharp_px=view.sharp, sized=known)
    if (~faced).any():
        noise[:, ~faced] = point_covariance(finder, blur[:, ~faced], sharp_px=view.sharp)
    return noise


def _edges(view: _View, finder: Finder, seen: Mask, visible: Mask) -> tuple[Array, Array, Array]:
    """Return W (P, F, 2, 2) of edges' displacements and slopes, and the sigma (P, F) px of each as a whole.

    Each station measures across its piece of edge; those of a straight edge all in the same direction.
    """
    places = view.places
    along = np.nan_to_num(_along(view))
    length = np.linalg.norm(along, axis=-1)
    use = visible & seen[:, places.feature] & places.is_edge[places.feature] & (length > _FLAT)
    whole = view.sums(np.where(use[..., None], along, 0.0))
    along = np.where(places.is_straight[places.feature][:, None], whole[:, places.feature], along)
    n = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    n = n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
    total = np.maximum(view.sums(np.where(use, length, 0.0)), 1e-12)
    with np.errstate(invalid="ignore"):
        variance = edge_variance(finder, total, view.blur, sharp_px=view.sharp)
        weight = np.where(use, length / (total * variance)[:, places.feature], 0.0)
    weight = np.nan_to_num(weight)
    nn = weight[..., None, None] * (n[..., :, None] * n[..., None, :])
    # the slope is that about the middle of the visible stations
    middle = view.sums(weight * places.from_middle) / np.maximum(view.sums(weight), 1e-300)
    lever = places.from_middle - middle[:, places.feature]
    return view.sums(nn), view.sums(nn * (lever**2)[..., None, None]), np.asarray(np.sqrt(variance))
