"""Whether the photos of a rig, or of a camera that was moved, agree on one pose.

A camera that does not stand, or look, where it is said to shows the part beside where the others have it. A pose fitted
to all of them goes part of the way to each and leaves lines off by little, for what one photo alone tells poorly, as
its depth, takes up the rest: edges that scatter hardly more hide an error of the pose of many times its uncertainty.

1. In each photo the part is laid onto the steps by turning that camera alone, as any error of its place or direction
   shifts what it sees: three unknowns, which few lines tell. By how far the part's middle moves, r (2,) mm across the
   line of sight, that photo disagrees with the pose of all.
2. Cameras that are off by twists s_j (of the part, as they see it) move the pose by sum_j P_j s_j, P_j being the share
   of photo j in it, and r_i = L_i (s_i - sum_j P_j s_j), L_i being how a twist moves the part across the line of sight.
   How far cameras are off, in place and by direction, is such that sum_i |r_i|^2 / E |r_i|^2 is what it should be
   (R. C. Paule, J. Mandel, J. Res. NBS 87, 1982, for laboratories that disagree). The pose is that much less sure.
3. Where a photo disagrees beyond doubt, and by more than is left in any calibration, the answer says so: a camera file
   without a covariance does not claim to be exact. What is less makes the pose less sure (2.), and what is measured
   with these cameras (`Location.cameras_off_mm`). Of three photos or more the one is left out without which the others
   agree, best by all but noise, if there is just one such. A photo that shows nothing of the part is left out, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry
from cadcam.geometry.plane import axes_across
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import hat
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.lines.attraction import attracted
from cadcam.locate.lines.sight import Sight
from cadcam.locate.location import Disagreement, Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.absent import LEAST
from cadcam.locate.quality.support import Support, support_at
from cadcam.locate.refine.options import EdgeOptions
from cadcam.locate.refine.solution import CLOSE_PX, LOOSE_PX, PoseSolution, solved
from cadcam.locate.uncertainty import calibration_covariance, weakest_direction

_TURNS = 3  # unknowns of a camera that turns
_TELLING = 0.5  # share of what lines tell that these may take, of a photo that would show the part
_SURELY = 36.0  # squared standard deviations of a shift of two numbers that noise does not make
_LEAST_PX = 0.2  # by which lines must move at least: less may be the calibration (docs/benchmarks/real_calibrations.md)
_SHOWN = 0.25  # quality at which a photo tells by itself where the part is, if its lines are near
_FAR_PX, _CLEARLY = 40.0, (0.5, 0.2)  # px that others are looked for; their quality, and how much above that in place
_LEFT = 0.1  # share of a photo's own noise that is left between it and the pose of all, at least
_REFUSED = 0.45  # quality of a pose that photos contradict


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Where one photo shows the part: number of the photo, shift (2,) mm across the line of sight, and how sure it is.

    moved (2, 6): L, the shift by a twist of the part; share (6, 6): P, the pose by a twist that this photo alone sees;
    off (6, 6): twists by which a camera is off by 1 mm, in place or by its direction. noise: variance of the two
    numbers of the shift together that is left at the fitted pose, mm²; px: how far the lines move in the photo.
    """

    photo: int
    shift: Array
    covariance: Array
    moved: Array
    share: Array
    off: Array
    noise: float
    px: float

    @property
    def squared(self) -> float:
        """Return the squared length of the shift in standard deviations."""
        return float(self.shift @ np.linalg.solve(self.covariance, self.shift))

    @property
    def sure(self) -> bool:
        """Return whether the photo disagrees beyond doubt, and by more than a calibration may be off."""
        return self.doubtless and self.px >= _LEAST_PX

    @property
    def doubtless(self) -> bool:
        """Return whether noise, and what is said of the calibration, does not make the shift, however small it is."""
        return self.squared > _SURELY


@dataclass(frozen=True, slots=True, eq=False)
class Concord:
    """How far photos agree with the pose fitted to all of them. blind: the photos that show nothing of the part there.

    variance: of how far cameras are off, in any direction, mm².
    """

    photos: Sequence[Beside]
    blind: Sequence[int]
    variance: float

    @classmethod
    def of(cls, fitted: PoseSolution, options: EdgeOptions) -> Concord:
        """Return how far the photos of a fit agree."""
        every = [_beside(fitted, k, gain, options) for k, gain in enumerate(_gains(fitted))]
        photos = [one for one in every if one is not None]
        blind = [k for k, s in enumerate(fitted.sights) if every[k] is None and _blind(s, fitted.pose)]
        return cls(photos, blind, _variance(photos))

    @property
    def holds(self) -> bool:
        """Return whether no photo disagrees by more than calibrations may be off."""
        return not any(one.sure for one in self.photos)

    @property
    def close(self) -> bool:
        """Return whether the photos agree but for noise and what is said of their calibrations."""
        return not any(one.doubtless for one in self.photos)

    @property
    def contradicted(self) -> bool:
        """Return whether a photo shows the part so far beside that its lines there are others."""
        return any(one.sure and one.px > CLOSE_PX for one in self.photos)

    def told(self, location: Location, part: Part, photos: Sequence[Photo]) -> Location:
        """Return the answer as uncertain as this makes it; not certain where photos contradict each other."""
        before, B = location.pose, location.pose.freedom
        pulls = [one.share @ one.off for one in self.photos]
        added = sum((self.variance * P @ P.T for P in pulls), np.zeros((6, 6)))
        pose = replace(before, from_noise=before.from_noise + B @ (B.T @ added @ B) @ B.T)
        was, now = (weakest_direction(p, part.aspects.centre, photos) for p in (before, pose))
        reason = location.reason.replace(was, now)
        location = replace(location, pose=pose, cameras_off_mm=float(np.sqrt(self.variance)))
        if self.holds:
            return replace(location, reason=reason)
        of = self.disagreements([one.photo for one in self.photos if one.sure], photos, left_out=False)
        location = replace(location, disagreements=of)
        said = f"{self._words(photos)}: does every camera stand where its file says?"
        if not self.contradicted:
            return replace(location, reason=f"{reason}; the photos disagree: {said}")
        reason = f"not certain: the photos contradict each other: {said} ({reason})"
        return replace(location, quality=min(_REFUSED, location.quality), reason=reason)

    def disagreements(
        self, numbers: Sequence[int], photos: Sequence[Photo], *, left_out: bool
    ) -> tuple[Disagreement, ...]:
        """Return of each of the numbered photos by how far it disagrees."""
        px = {one.photo: one.px for one in self.photos}
        names = [photos[k].viewpoint.name for k in numbers]
        each = zip(numbers, names, strict=True)
        return tuple(Disagreement(k, name, px.get(k, float("nan")), left_out) for k, name in each)

    def _words(self, photos: Sequence[Photo]) -> str:
        """Return which photo disagrees most surely, and by how much."""
        one = max((p for p in self.photos if p.sure), key=lambda p: p.squared)
        by = f"{np.linalg.norm(one.shift):.2g} mm ({one.px:.1f} px)"
        return f"{photos[one.photo].viewpoint.name!r} shows the part {by} beside where all together have it"


def _gains(fitted: PoseSolution) -> list[Array]:
    """Return by how much offsets (n,) of each photo shift the pose, (6, n)."""
    n = np.cumsum([int(m.usable.sum()) for m in fitted.measured])
    return np.split(fitted.B @ fitted.fit.gain[:, : n[-1]], n[:-1], axis=1)


def _beside(fitted: PoseSolution, k: int, gain: Array, options: EdgeOptions) -> Beside | None:
    """Return where the k-th photo shows the part, or None where it does not tell by itself. gain: as of `_gains`."""
    sight, pose = fitted.sights[k], fitted.pose
    turn = _turning(sight.photo.viewpoint.camera_from_world)
    if not len(sight.samples):
        return None
    alone = _laid(sight, pose, turn, options)
    if alone is None:
        return None
    place, usable = alone.places[0], alone.measured[0].usable
    p, normal = sight.samples.p[usable], place.normal[usable]
    c = p.mean(axis=0)
    across = _across(sight, pose, c)
    moved = across @ pose.rotation @ np.concatenate([np.eye(3), -hat(c)], axis=1)
    own = alone.B @ alone.fit.gain[:, : len(p)]
    by_noise = alone.B @ (alone.fit.covariance + alone.hidden_by_blur) @ alone.B.T
    by_calibration = calibration_covariance([sight.photo], [p], [normal], [own], pose)
    share = gain @ fitted.places[k].row[fitted.measured[k].usable]
    shift = across @ (alone.pose @ c - pose @ c)
    covariance = moved @ (by_noise + by_calibration) @ moved.T
    # What the photo itself says is in the pose already: less noise is left between the two.
    known = moved @ fitted.B @ fitted.fit.covariance @ fitted.B.T @ moved.T
    noise = max(float(np.trace(covariance - known)), _LEFT * float(np.trace(covariance)))
    off, px = _off(sight, pose, c), sight.moved_px(pose, alone.pose)
    return Beside(k, shift, covariance, moved, share, off, noise, px)


def _laid(sight: Sight, pose: Rigid, turn: Freedom, options: EdgeOptions) -> PoseSolution | None:
    """Return the part laid onto the steps of one photo, from near its pose or, if it is clearly shown there, afar.

    Where it does not fit there, the pose of all lies between those of several photos: then it moves freely.
    """
    here = _seen(sight, pose).quality
    for search_px, freedom in ((options.search_px, turn), (options.search_px, FREE), (_FAR_PX, turn)):
        try:
            alone = solved([sight], attracted([sight], pose, freedom, search_px=search_px), freedom, (), options)
        except DegenerateGeometry:
            continue
        there, far = _seen(sight, alone.pose).quality, sight.moved_px(pose, alone.pose) > CLOSE_PX
        if alone.fit.between < LOOSE_PX and there >= (max(_CLEARLY[0], here + _CLEARLY[1]) if far else _SHOWN):
            return alone
    return None


def _blind(sight: Sight, pose: Rigid) -> bool:
    """Return whether a photo would show enough of the part to be sure of it, and does not."""
    shown = _seen(sight, pose)
    return shown.samples >= LEAST and shown.fitted < _TELLING and shown.quality < _SHOWN


def _seen(sight: Sight, pose: Rigid) -> Support:
    return support_at([sight], pose, constraints=_TURNS, scatter=0.0)


def _turning(camera_from_world: Rigid) -> Freedom:
    """Return the turns of a camera about its centre, as motions of the part."""
    about = [Freedom.about(camera_from_world.origin, axis).basis[:, 0] for axis in camera_from_world.rotation]
    return Freedom(np.stack(about, axis=1), "world")


def _across(sight: Sight, pose: Rigid, c: Array) -> Array:
    """Return two directions (2, 3) of the world across the line of sight to a point of the part."""
    seen_at = pose @ c - sight.photo.viewpoint.camera_from_world.origin
    return np.stack(axes_across(seen_at / np.linalg.norm(seen_at)))


def _off(sight: Sight, pose: Rigid, c: Array) -> Array:
    """Return the twists (6, 6) of the part at a pose that a camera sees which is off by 1 mm at a point of the part."""
    camera = sight.photo.viewpoint.camera_from_world
    away = float(np.linalg.norm(pose @ c - camera.origin))
    placed = np.concatenate([np.eye(3), np.zeros((3, 3))])
    return np.asarray(pose.inv.adjoint() @ np.concatenate([placed, _turning(camera).basis / away], axis=1))


def _variance(photos: Sequence[Beside]) -> float:
    """Return the variance (mm²) of how far cameras are off, in any direction, from where their photos show the part."""
    from scipy.optimize import brentq

    if len(photos) < 2:
        return 0.0
    square, noise = np.array([one.shift @ one.shift for one in photos]), np.array([one.noise for one in photos])
    by = [[one.moved @ (np.eye(6) * (other is one) - other.share) @ other.off for other in photos] for one in photos]
    share = np.array([sum(float((R**2).sum()) for R in row) for row in by])

    def excess(variance: float) -> float:
        return float((square / (noise + share * variance)).sum()) - (len(photos) - 1)

    if excess(0.0) <= 0:
        return 0.0
    most = float((square / np.maximum(share, 1e-12)).sum())
    return float(brentq(excess, 0.0, most))
