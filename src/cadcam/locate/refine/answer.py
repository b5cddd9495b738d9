"""What a solution amounts to: the pose with its covariance, the evidence for the part there, and the samples.

The covariance is that of noise and of errors common to an edge, plus that of the calibration. The quality is that of
`locate.quality.support`, evaluated again without lines hidden by the light where it would narrowly be too low.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.lines.bands import MOST_PX
from cadcam.locate.lines.sight import Sight, in_noise
from cadcam.locate.location import FOUND, MORE_THAN_LIGHT, Covered, Location, unmeasured
from cadcam.locate.matches import EdgeMatches
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.color import in_color
from cadcam.locate.quality.contrast import showing
from cadcam.locate.quality.occluder import CONSTRAINTS, covered, side_words
from cadcam.locate.quality.support import Support, judged_support, support_at
from cadcam.locate.reason import Reason, Refusal
from cadcam.locate.refine.agreement import SCATTERED_PX
from cadcam.locate.refine.solution import LOOSE_PX, PoseSolution
from cadcam.locate.uncertainty import calibration_covariance, weakest_direction, with_known_poses

DOUBT = (0.25, 0.62)  # range of quality, of poses that half of the lines agree with, that deserves a second look
_SOME = 0.3  # share of the lines shown beyond chance from which it is tested whether something is before the others
_HALF = 0.5  # share of the lines shown from which it is tested whether light hides the others
_TOGETHER_PX = 0.005  # error common to all edges of a photo: light from one side bends alike beside them
_FREE = 0.4  # share of the lines that any pose could be fitted to, more than for a box: little else is evidence
CLEARLY = 0.1  # by how much an answer that is not found must be better to replace another one
_WHITE = 0.25  # share of the lines beside white from which a shorter exposure is advised
# Error of the edges as a whole, px and in blurs of the photo, that light makes at most. In the battery none of 60 right
# poses of exact models had more; 16 of 26 wrong models, focal lengths and lenses that passed had.
_AMISS_PX, _AMISS_OF_BLUR = 0.4, 0.2
_LOOSER, _LOOSER_BESIDE_BANDS = 3.0, 2.0  # ratio of scatter from which a fit is looser than another


@dataclass(frozen=True, slots=True, eq=False)
class PoseAnswer:
    """A location, the solution it was measured by (None for none), and the lines drawn for it."""

    location: Location
    solution: PoseSolution | None
    sights: Sequence[Sight]

    @property
    def pose(self) -> Rigid:
        """Return the pose world_from_part."""
        return self.location.pose.world_from_part

    @property
    def loose(self) -> bool:
        """Return whether edges fit the pose only loosely."""
        return self.solution is not None and self.solution.fit.between > LOOSE_PX

    @property
    def scattered(self) -> bool:
        """Return whether edges of a found pose scatter so much that some may lie on the far sides of bands."""
        fitted = self.solution
        if fitted is None or not self.location.found:
            return False
        return fitted.regression.bands and fitted.scatter > SCATTERED_PX

    def unlike(self, part: Part, other: PoseSolution, share: float) -> PoseAnswer:
        """Return the answer with a further error: `share` of the way to another solution, as a standard deviation."""
        at = self.location.pose
        away = at.world_from_part.inv @ other.pose
        px = max(s.moved_px(self.pose, other.pose) for s in self.sights)
        by = share * min(1.0, MOST_PX / max(px, 1e-300)) * (at.freedom @ (at.freedom.T @ away.log()))
        photos = [s.photo for s in self.sights]
        return replace(self, location=less_sure(self.location, np.outer(by, by), part.aspects.centre, photos))

    def better_than(self, other: PoseAnswer) -> bool:
        """Return whether this answer is better than another: by quality, and by how closely edges fit.

        Edges of a loose fit are met at a larger distance. If one of the two is much looser, both are judged at the
        distance of the other. Beside bands the closer of two is better, if both are found or equally good: with some
        lines on the far sides of bands, which are as clear as the near ones, more may be shown, but they do not agree.
        """
        one, two = self.solution, other.solution
        if one is None or two is None:
            return self.location.quality > other.location.quality
        bands = one.regression.bands or two.regression.bands
        scatter = (one.scatter, two.scatter) if bands else (one.fit.between, two.fit.between)
        looser = _LOOSER_BESIDE_BANDS if bands else _LOOSER
        if max(scatter) <= max(SCATTERED_PX, looser * min(scatter)):
            return self.location.quality > other.location.quality
        if bands and self.location.found and other.location.found:
            return scatter[0] < scatter[1]
        quality = [support_at(s.sights, s.pose, constraints=s.B.shape[1], scatter=0.0).quality for s in (one, two)]
        if bands and abs(quality[0] - quality[1]) < CLEARLY:
            return scatter[0] < scatter[1]
        return quality[0] > quality[1]


def less_sure(location: Location, added: Array, centre: Array, photos: Sequence[Photo]) -> Location:
    """Return a location with a further covariance (6, 6) of its pose; its reason says how well that is known now."""
    pose = replace(location.pose, from_noise=location.pose.from_noise + added)
    return replace(location, pose=pose, why=location.why.knowing(weakest_direction(pose, centre, photos)))


def location_of(part: Part, fitted: PoseSolution, freedom: Freedom, *, chosen: int, wider: bool) -> Location:
    """Return the location of a solution. chosen, wider: as for `refine_pose`."""
    B = freedom.at(fitted.pose)
    estimate = replace(_estimate(part, fitted, B), undetermined=unseen_turns(part, freedom, fitted.pose))
    evidence, doubted = _evidence(part, fitted, B, chosen, wider)
    return Location(
        estimate,
        _matches(fitted),
        evidence.quality,
        _reason(part, estimate, evidence, fitted),
        doubted=doubted,
        covered=Covered(evidence.covered, evidence.side) if evidence.covered > 0 else None,
        judged=evidence.judged,
        off_px=fitted.fit.between if _amiss(fitted) else 0.0,
    )


def _estimate(part: Part, fitted: PoseSolution, B: Array) -> PoseEstimate:
    """Return the pose of a solution with its covariance, along the free motions B (6, k)."""
    fit = fitted.fit
    n = [int(m.usable.sum()) for m in fitted.measured]
    gains = np.split(B @ fit.gain[:, : sum(n)], np.cumsum(n)[:-1], axis=1)  # (6, n) of each photo: twist by offsets
    points = [s.samples.p[m.usable] for s, m in zip(fitted.sights, fitted.measured, strict=True)]
    normals = [at.normal[m.usable] for at, m in zip(fitted.places, fitted.measured, strict=True)]
    together = sum(
        (_TOGETHER_PX**2 * (G @ n) @ (G @ n).T for G, n in zip(gains, normals, strict=True)), np.zeros((6, 6))
    )
    from_noise = B @ (fit.covariance + fitted.hidden_by_blur + fitted.by_contours) @ B.T + together
    photos = [s.photo for s in fitted.sights]
    by_cameras = fitted.by_cameras
    measured = calibration_covariance(photos, points, normals, gains, fitted.pose, beside=by_cameras)
    from_calibration = with_known_poses(measured, fitted.known_poses, part.aspects.radius)
    return PoseEstimate(fitted.pose, from_noise, from_calibration, B, fit.dof)


def unseen_turns(part: Part, freedom: Freedom, pose: Rigid) -> Array:
    """Return the turns (6, k), orthonormal twists, that a freedom allows at a pose and that no photo can show."""
    middle, radius = part.aspects.centre, part.aspects.radius
    return freedom.among(part.spins, pose, center=middle, radius=radius)


def lost(sights: Sequence[Sight], pose: Rigid, freedom: Freedom, why: str) -> Location:
    """Return the answer where nothing could be measured."""
    none = [np.full(len(s.samples), np.nan) for s in sights]
    matches = _as_matches(sights, pose, none, none, [np.zeros(len(a)) for a in none])
    return Location(unmeasured(pose, freedom.at(pose)), matches, 0.0, _not_found(why, sights, pose))


def _evidence(part: Part, fitted: PoseSolution, B: Array, chosen: int, wider: bool) -> tuple[Support, bool]:
    """Return the evidence of the photos for the part, fitted along B (6, k), and whether it is doubted.

    For a pose that would not be found lines behind something that stands before the part are left out, and if half of
    them show, those without contrast under the light; the latter not if the model fits better when stretched. Neither
    where starts are known to be good (not `wider`).
    """
    pose, fit = fitted.pose, fitted.fit
    told, color = in_color(part, fitted.sights, pose)
    bands = fitted.regression.bands and fitted.tells_lines and fitted.scatter <= LOOSE_PX
    hidden = fitted.hidden_px
    scatter = float(np.hypot(fitted.scatter, np.sqrt(np.mean(hidden**2)))) if hidden.any() else fitted.scatter
    ask = partial(judged_support, world_from_part=pose, B=B, scatter=scatter, color=color, bands=bands)
    evidence = ask(told, chosen=chosen)
    doubted = evidence.quality < FOUND or evidence.without > 0 or evidence.fitted > _FREE or fit.between > LOOSE_PX
    if wider and evidence.quality < FOUND:
        told, evidence, chosen = _in_front(ask, told, pose, evidence, chosen, scatter)
        if not in_noise(fitted.sights):  # in noise, missing lines pass for faint ones
            evidence = _in_light(ask, part, told, pose, evidence, chosen)
    return evidence, doubted


def _in_front(
    ask: Callable[..., Support], sights: list[Sight], pose: Rigid, evidence: Support, chosen: int, scatter: float
) -> tuple[list[Sight], Support, int]:
    """Return sights and evidence without what something before the part hides, where that speaks for the pose.

    And how many constraints were then met by choosing.
    """
    if evidence.shown - evidence.by_chance < _SOME:
        return sights, evidence, chosen
    behind, borders = covered(sights, pose, scatter)
    if not borders:
        return sights, evidence, chosen
    more, clear = chosen + CONSTRAINTS * borders, [s.select(~its) for s, its in zip(sights, behind, strict=True)]
    share, side = 1 - _samples(clear) / _samples(sights), side_words(sights, pose, behind)
    rest = ask(clear, chosen=more).uncovered(evidence, share, side)
    return (clear, rest, more) if rest.quality > evidence.quality else (sights, evidence, chosen)


def _in_light(
    ask: Callable[..., Support], part: Part, sights: Sequence[Sight], pose: Rigid, evidence: Support, chosen: int
) -> Support:
    """Return the evidence without the lines that have no contrast under the light."""
    if evidence.gain or evidence.quality >= FOUND or evidence.shown < _HALF:
        return evidence
    lit = showing(part, sights, pose)
    faint = 1 - _samples(lit) / _samples(sights)
    if faint == 0:
        return evidence
    left = ask(lit, chosen=chosen)
    determined = max(left.determined, evidence.determined)
    return replace(left, faint=faint, covered=evidence.covered, side=evidence.side, determined=determined)


def _samples(sights: Sequence[Sight]) -> int:
    return sum(len(s.samples) for s in sights)


def _reason(part: Part, estimate: PoseEstimate, evidence: Support, fitted: PoseSolution) -> Reason:
    """Return why the pose is believed, and how well it is known; or why it is not."""
    if evidence.quality < FOUND:
        return _not_found(str(evidence), fitted.sights, fitted.pose)
    weakest = weakest_direction(estimate, part.aspects.centre, [s.photo for s in fitted.sights])
    beside = ", many beside bands that the model does not have" * fitted.regression.bands
    amiss = f", {MORE_THAN_LIGHT}" * _amiss(fitted)
    off = f"edges are off by {fitted.fit.between:.2f} px as a whole{beside}{amiss}"
    return Reason(f"{evidence}; {off}", known=weakest)


def _amiss(fitted: PoseSolution) -> bool:
    """Return whether edges are off by more than light and blur make of them: model or camera may be wrong."""
    blur = max((float(c.blurs.max(initial=0.0)) for c in fitted.cells), default=0.0)
    return fitted.fit.between > max(_AMISS_PX, _AMISS_OF_BLUR * blur)


def _not_found(why: str, sights: Sequence[Sight], pose: Rigid) -> Reason:
    """Return why a pose is not found, and that the photos are white beside many of the lines, if they are."""
    reason = Reason(why, Refusal.NOT_FOUND)
    white = np.concatenate([np.zeros(0), *(s.white_beside(s.project(pose)) for s in sights)])
    if not len(white) or white.mean() < _WHITE:
        return reason
    beside = f"beside {white.mean():.0%} of the part's edges the photo is white"
    return reason.noting(f"{beside}: with less light more would show")


def _matches(fitted: PoseSolution) -> EdgeMatches:
    """Return the samples as the refined pose projects them, offsets and weights as measured for it."""
    weights, offsets, done = [], [], 0
    each = fitted.fit.weight * fitted.fit.of_group[fitted.fit.group]
    for m, moved in zip(fitted.measured, fitted.moved, strict=True):
        n = int(m.usable.sum())
        weight = np.zeros(len(m.offset))
        weight[m.usable] = each[done : done + n]
        done += n
        weights.append(weight)
        offsets.append(np.where(m.usable, m.offset - moved, np.nan))
    sigma = [np.where(m.usable, m.sigma, np.nan) for m in fitted.measured]
    return _as_matches(fitted.sights, fitted.pose, offsets, sigma, weights)


def _as_matches(
    sights: Sequence[Sight], pose: Rigid, offset: Sequence[Array], sigma: Sequence[Array], weight: Sequence[Array]
) -> EdgeMatches:
    """Return the samples of all photos in one list, without those that are not imaged at the pose."""
    places = [s.project(pose) for s in sights]
    kept = [at.imaged for at in places]

    def joined(parts: Sequence[Array]) -> Array:
        return np.concatenate([a[k] for a, k in zip(parts, kept, strict=True)])

    numbers = [
        np.column_stack([s.samples.chain, np.full(len(s.samples), i)])[k]
        for i, (s, k) in enumerate(zip(sights, kept, strict=True))
    ]
    chain, photo = np.concatenate(numbers).astype(np.int32).T
    q, normal = joined([at.q for at in places]), joined([at.normal for at in places])
    p = joined([s.samples.p for s in sights])
    return EdgeMatches(q, normal, joined(offset), joined(sigma), joined(weight), p, chain, photo)
