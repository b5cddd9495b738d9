"""Consistency of several photos, of a rig or of a camera that was moved: whether they agree on one pose.

A camera whose place or direction is not as its file says shows the part beside where the other cameras have it. A pose
fitted to all of them is a compromise. It moves the lines by little, as what one photo tells poorly, such as depth,
takes up the rest: the residuals hardly grow, while the pose is off by many times its stated uncertainty. Therefore:

1. In each photo the part is fitted by turning that camera alone (three unknowns, which few lines determine): an error
   of its place or direction shifts what it sees in nearly the same way. The shift r (2,) of the part's middle across
   the line of sight, in mm, is that photo's disagreement with the pose of all.
2. How far cameras are off is estimated as a variance component. Cameras that are off by twists s_j (of the part, as
   they see it) move the common pose by sum_j P_j s_j, P_j being the derivative of that pose by what photo j sees, and
   shift r_i = L_i (s_i - sum_j P_j s_j), L_i being the derivative of the shift by a twist. The variance of the errors
   in place and direction follows from sum_i |r_i|^2 / E |r_i|^2 (`_variance`; after R. C. Paule, J. Mandel, J. Res. NBS
   87, 1982, for laboratories that disagree). It is added to the covariance of the pose, and to that of what
   is measured with these cameras (`Location.cameras_off_mm`).
3. A photo is named as inconsistent if noise does not explain its shift and the shift is larger than what calibrations
   usually leave: a camera file without a covariance does not claim to be exact. Of three photos or more one is left out
   if there is just one without which the others agree, best by all but noise. A photo that shows nothing of the part
   is left out, too.
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
from cadcam.locate.refine.answer import less_sure
from cadcam.locate.refine.options import EdgeOptions
from cadcam.locate.refine.solution import CLOSE_PX, LOOSE_PX, PoseSolution, solved
from cadcam.locate.uncertainty import calibration_covariance

_TURNS = 3  # unknowns of a camera that turns
_MOST_FITTED = 0.5  # of a photo that would show the part: share of its evidence that these unknowns may explain
_SURELY = 36.0  # squared standard deviations of a shift of two numbers that noise does not make
_LEAST_PX = 0.2  # by which lines must move at least: less may be the calibration (docs/benchmarks/real_calibrations.md)
_SHOWN = 0.25  # quality from which a photo by itself tells where the part is, if its lines are near
_FAR_PX = 40.0  # search range where the part may be shown elsewhere in the photo
_CLEARLY, _CLEARER = 0.5, 0.2  # quality of what is found far off: at least, and more than at the pose of all
_LEAST_NOISE = 0.1  # of a photo's own variance: the least that is assumed between it and the pose of all


@dataclass(frozen=True, slots=True, eq=False)
class PhotoShift:
    """By how much one photo, fitted alone, shifts the part: its disagreement with the pose of all photos.

    photo: its number; shift (2,): of the part's middle across the line of sight, mm, with its covariance; noise:
    variance of both numbers together that the fit to all photos leaves between them, mm²; px: how far it moves the
    part's lines in the photo (`Sight.moved_px`).

    moved (2, 6): derivative of the shift by a twist of the part (L of the module); share (6, 6): of the pose of all by
    a twist that this photo alone sees (P); off (6, 6): the twists that this camera sees if it is off by 1 mm, in place
    (three columns) or by its direction (three columns).
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
        """Return the squared length of the shift in standard deviations (Mahalanobis)."""
        return float(self.shift @ np.linalg.solve(self.covariance, self.shift))

    @property
    def inconsistent(self) -> bool:
        """Return whether the photo disagrees significantly, and by more than a calibration may be off."""
        return self.significant and self.px >= _LEAST_PX

    @property
    def significant(self) -> bool:
        """Return whether noise and the stated calibration do not explain the shift, however small it is."""
        return self.squared > _SURELY


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """How far photos agree with the pose fitted to all of them.

    photos: the shifts of those that tell by themselves where the part is; blind: numbers of those that show nothing of
    it there. variance: of how far cameras are off, in any direction, mm².
    """

    photos: Sequence[PhotoShift]
    blind: Sequence[int]
    variance: float

    @classmethod
    def of(cls, fitted: PoseSolution, options: EdgeOptions) -> Consistency:
        """Return the consistency of the photos that a pose was fitted to."""
        every = [_photo_shift(fitted, k, gain, options) for k, gain in enumerate(_gains(fitted))]
        photos = [one for one in every if one is not None]
        blind = [k for k, s in enumerate(fitted.sights) if every[k] is None and _blind(s, fitted.pose)]
        return cls(photos, blind, _variance(photos))

    @property
    def holds(self) -> bool:
        """Return whether no photo disagrees by more than calibrations may be off."""
        return not any(one.inconsistent for one in self.photos)

    @property
    def close(self) -> bool:
        """Return whether noise and the stated calibrations explain all that is between the photos."""
        return not any(one.significant for one in self.photos)

    @property
    def contradicted(self) -> bool:
        """Return whether a photo shows the part so far off that the pose of all is measured at other edges there."""
        return any(one.inconsistent and one.px > CLOSE_PX for one in self.photos)

    def stated_in(self, location: Location, part: Part, photos: Sequence[Photo]) -> Location:
        """Return the location with what the photos' consistency says of it.

        Its covariance grows by the cameras' variance; photos that are inconsistent are listed in `disagreements` and in
        the reason. Where photos contradict each other, its quality is below that of a part that is found.
        """
        location = self._less_certain(location, part, photos)
        if self.holds:
            return location
        numbers = [one.photo for one in self.photos if one.inconsistent]
        location = replace(location, disagreements=self.disagreements(numbers, photos, left_out=False))
        said = f"{self._words(photos)}: does every camera stand where its file says?"
        if not self.contradicted:
            return location.noting(f"the photos disagree: {said}")
        return location.uncertain(f"the photos contradict each other: {said}")

    def _less_certain(self, location: Location, part: Part, photos: Sequence[Photo]) -> Location:
        """Return the location with the cameras' variance carried into the covariance of its pose, and its reason."""
        B = location.pose.freedom
        pulls = [one.share @ one.off for one in self.photos]
        added = sum((self.variance * P @ P.T for P in pulls), np.zeros((6, 6)))
        grown = less_sure(location, B @ (B.T @ added @ B) @ B.T, part.aspects.centre, photos)
        return replace(grown, cameras_off_mm=float(np.sqrt(self.variance)))

    def disagreements(
        self, numbers: Sequence[int], photos: Sequence[Photo], *, left_out: bool
    ) -> tuple[Disagreement, ...]:
        """Return the disagreement of each of the numbered photos; px is NaN for those that show nothing of the part."""
        px = {one.photo: one.px for one in self.photos}
        return tuple(Disagreement(k, photos[k].viewpoint.name, px.get(k, float("nan")), left_out) for k in numbers)

    def _words(self, photos: Sequence[Photo]) -> str:
        """Return which photo disagrees most significantly, and by how much."""
        one = max((p for p in self.photos if p.inconsistent), key=lambda p: p.squared)
        by = f"{np.linalg.norm(one.shift):.2g} mm ({one.px:.1f} px)"
        return f"{photos[one.photo].viewpoint.name!r} shows the part {by} beside where all together have it"


def _gains(fitted: PoseSolution) -> list[Array]:
    """Return for each photo the derivative (6, n) of the fitted twist by the offsets (n,) measured in it."""
    n = np.cumsum([int(m.usable.sum()) for m in fitted.measured])
    return np.split(fitted.B @ fitted.fit.gain[:, : n[-1]], n[:-1], axis=1)


def _photo_shift(fitted: PoseSolution, k: int, gain: Array, options: EdgeOptions) -> PhotoShift | None:
    """Return where the k-th photo alone shows the part, or None if it does not tell. gain: its part of `_gains`."""
    sight, pose = fitted.sights[k], fitted.pose
    turn = _turning(sight.photo.camera_from_world)
    if not len(sight.samples):
        return None
    alone = _fitted_alone(sight, pose, turn, options)
    if alone is None:
        return None
    c = sight.samples.p[alone.measured[0].usable].mean(axis=0)
    across = _across(sight, pose, c)
    moved = across @ pose.rotation @ np.concatenate([np.eye(3), -hat(c)], axis=1)
    by_noise = moved @ alone.B @ (alone.fit.covariance + alone.hidden_by_blur + alone.by_contours) @ alone.B.T @ moved.T
    by_calibrations = moved @ _apart_by_calibrations(alone, fitted, k) @ moved.T
    # The photo has its share in the pose of all: what that pose knows of the shift is no difference between the two.
    known = moved @ fitted.B @ fitted.fit.covariance @ fitted.B.T @ moved.T
    noise = max(float(np.trace(by_noise - known)), _LEAST_NOISE * float(np.trace(by_noise)))
    return PhotoShift(
        photo=k,
        shift=across @ (alone.pose @ c - pose @ c),
        covariance=by_noise + by_calibrations,
        moved=moved,
        share=gain @ fitted.places[k].row[fitted.measured[k].usable],
        off=_off(sight, pose, c),
        noise=noise + float(np.trace(by_calibrations)),
        px=sight.moved_px(pose, alone.pose),
    )


def _apart_by_calibrations(alone: PoseSolution, fitted: PoseSolution, k: int) -> Array:
    """Return the covariance (6, 6) of the twist between the fit to the k-th photo alone and that to all.

    By all stated calibrations: those of other photos move the pose of all away from what this one shows.
    """
    solutions, signs = (alone, fitted), (1.0, -1.0)
    photos = [sight.photo for one in solutions for sight in one.sights]
    points = [s.samples.p[m.usable] for one in solutions for s, m in zip(one.sights, one.measured, strict=True)]
    normals = [at.normal[m.usable] for one in solutions for at, m in zip(one.places, one.measured, strict=True)]
    gains = [sign * gain for one, sign in zip(solutions, signs, strict=True) for gain in _gains(one)]
    beside = fitted.by_cameras
    if beside:
        beside = [np.zeros_like(beside[k]), *(-one for one in beside)]
    return calibration_covariance(photos, points, normals, gains, fitted.pose, beside=beside)


def _fitted_alone(sight: Sight, pose: Rigid, turn: Freedom, options: EdgeOptions) -> PoseSolution | None:
    """Return the fit of the part to one photo's edges by turning its camera, or None if it is not shown well enough.

    Three are tried, from the likeliest: a turn within the usual search range; a free motion, as the pose of all may lie
    between those of several photos and then fits none of them; and a turn farther away, where the part must be shown
    clearly and better than here.
    """
    here = _seen(sight, pose).quality
    for search_px, freedom in ((options.search_px, turn), (options.search_px, FREE), (_FAR_PX, turn)):
        try:
            alone = solved([sight], attracted([sight], pose, freedom, search_px=search_px), freedom, (), options)
        except DegenerateGeometry:
            continue
        far = sight.moved_px(pose, alone.pose) > CLOSE_PX
        least = max(_CLEARLY, here + _CLEARER) if far else _SHOWN
        if alone.fit.between < LOOSE_PX and _seen(sight, alone.pose).quality >= least:
            return alone
    return None


def _blind(sight: Sight, pose: Rigid) -> bool:
    """Return whether a photo would show enough of the part to be sure of it, and does not."""
    shown = _seen(sight, pose)
    return shown.samples >= LEAST and shown.fitted < _MOST_FITTED and shown.quality < _SHOWN


def _seen(sight: Sight, pose: Rigid) -> Support:
    """Return how much of the part one photo shows at a pose found by turning its camera."""
    return support_at([sight], pose, constraints=_TURNS, scatter=0.0)


def _turning(camera_from_world: Rigid) -> Freedom:
    """Return the turns of a camera about its centre of projection, as motions of the part in the world."""
    about = [Freedom.about(camera_from_world.origin, axis).basis[:, 0] for axis in camera_from_world.rotation]
    return Freedom(np.stack(about, axis=1), "world")


def _across(sight: Sight, pose: Rigid, c: Array) -> Array:
    """Return two unit vectors (2, 3) of the world across the line of sight to a point of the part."""
    seen_at = pose @ c - sight.photo.camera_from_world.origin
    return np.stack(axes_across(seen_at / np.linalg.norm(seen_at)))


def _off(sight: Sight, pose: Rigid, c: Array) -> Array:
    """Return the twists (6, 6) of the part that a camera sees if it is off by 1 mm in place, or turned by 1 mm at c."""
    camera = sight.photo.camera_from_world
    away = float(np.linalg.norm(pose @ c - camera.origin))
    placed = np.concatenate([np.eye(3), np.zeros((3, 3))])
    return np.asarray(pose.inv.adjoint() @ np.concatenate([placed, _turning(camera).basis / away], axis=1))


def _variance(photos: Sequence[PhotoShift]) -> float:
    """Return the variance (mm²) of how far cameras are off, in any direction, on the safe side.

    It solves sum_i |r_i|^2 / (noise_i + share_i variance) = n - 1 for n photos, and is 0 if noise alone is enough.
    Paule and Mandel have n - 1 for residuals over variances before the mean was taken. Here the expected values know
    what the common pose takes up, and the sum's is n: the variance is n / (n - 1) of an unbiased one. Of so few photos
    that one is often far too small, and the pose too sure.
    """
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
    most = float((square / np.maximum(share, 1e-12)).sum())  # there their sum is at most 1 even without noise
    return float(brentq(excess, 0.0, most))
