"""Distinguishes a found pose from its look-alikes: the part shifted by one bay, or turned over, or its mirror image.

Shifted by one bay, or turned over, a part may nearly coincide with itself, and so may its mirror image
(`locate.views.likeness`). At such a pose, a rival, most lines are met as well, and the share of missing lines does not
distinguish it from a partly hidden part. But the lines that only one of the two poses has do (`locate.quality.apart`):
at a right pose its own lines are shown about as often as the common ones. That is tested first, on the samples that the
fit has measured already, so that few rivals need to be drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.lines.attraction import attracted
from cadcam.locate.lines.sight import Sight
from cadcam.locate.location import FOUND, Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.absent import LEAST
from cadcam.locate.quality.apart import OWN_PX, Apart, Reading, away, shown_less, shows_alike, told_apart
from cadcam.locate.quality.support import ASKED
from cadcam.locate.reason import Refusal
from cadcam.locate.refine.options import EdgeOptions
from cadcam.locate.refine.refinement import Refinement, drawn
from cadcam.locate.refine.solution import LOOSE_PX
from cadcam.locate.views.likeness import Likeness
from cadcam.render.lines.visible import edge_points

_DOUBTED = 0.45  # quality given to a pose where the photos show a rival
_EVERY = 2  # of the judged samples, which lie in rows of four, so many are asked whose they are
_NEAR_PX = 2.0  # largest distance between lines and their steps, for a pose accurate to a pixel
_DENSE_PX = 3.0  # between points of an edge: less than the distance at which lines are near each other
_ROUNDS = 3  # how often a pose may be replaced by a rival
_CLOSER = 2.0  # ratio of their edges' scatter from which the closer of two poses as good is the better one
_REFINED, _AS_GOOD = 3, 0.1  # most rivals refined as alternatives; by how much less quality they may have
# By how much more lines must show for a part of the other hand than for one that is turned. A part hardly unlike its
# mirror image shows both all but alike: on a flange turned by a hole the mirror image has up to 0.04 more.
_RATHER = 0.1
_LAID_PX = 5.0  # largest error of a rival's lines before they are pulled onto the photos' steps


@dataclass(frozen=True, slots=True, eq=False)
class _Rival:
    """An alternative to a found pose: the pose of the part or its mirror image, and the evidence between the two.

    contested: whether far fewer of the found pose's own lines are shown than of those that both have.
    """

    like: Likeness
    pose: Rigid
    apart: Apart
    contested: bool


@dataclass(frozen=True, slots=True, eq=False)
class Rivals:
    """Compares found poses with their rivals, given the part, photos, freedom, and constraints met by the search."""

    part: Part
    photos: Sequence[Photo]
    freedom: Freedom
    options: EdgeOptions
    chosen: int

    def contested(self, found: Location) -> Mask:
        """Return for each likeness of the part (K,) whether far fewer of the found pose's own lines are shown.

        This costs next to nothing, so it can be asked of any pose, however good: where a look-alike is seen from where
        it is nearly the same, hardly any line is missing. Only feature edges count, and own ones are told in three
        dimensions: some lie on the rival's in the photo, and count as own all the same.
        """
        p, photo, shown = found.judged.p[::_EVERY], found.judged.photo[::_EVERY], found.judged.shown[::_EVERY]
        if not self.part.likenesses or not len(p):
            return np.zeros(len(self.part.likenesses), bool)
        views = [one.viewpoint for one in self.photos]
        eyes = np.array([(view.camera_from_world @ found.pose.world_from_part).origin for view in views])
        focal = np.array([view.camera.K[1, 1] for view in views])
        px_per_mm = focal[photo] / np.linalg.norm(p - eyes[photo], axis=1)
        return shown_less(self.part.own_edges.at(p) * px_per_mm > OWN_PX, shown, LEAST // _EVERY)

    def checked(self, found: Location, sights: Sequence[Sight] | None = None) -> Location:
        """Return the found pose, the rival that the photos show instead, or a refusal where they show the mirror image.

        A rival that takes its place is checked in turn. Rivals that nothing tells from the pose, though far fewer of
        its own lines are shown than of those they have in common or none of these is in view, are its alternatives if
        they fit as well. sights: the part's lines as drawn near the pose, if available. Where photos do not distinguish
        the part from its mirror image, the reason says so.
        """
        rivals: list[_Rival] = []
        for _ in range(_ROUNDS):
            rivals = self._rivals(found, sights)
            shown = [one for one in rivals if one.apart.against and not (one.like.mirrored and one.apart.few)]
            if not shown:
                break
            best = max(shown, key=lambda one: one.apart.margin - _RATHER * one.like.mirrored)
            if best.like.mirrored:
                return _mirrored(found, best.apart)
            other, sights = self._refined(best)
            if best.apart.few and other.quality <= found.quality:
                break
            if not other.found:
                return _doubted(found, f"elsewhere the part is shown as well: {best.apart}")
            found = other
        else:
            rivals = self._rivals(found, sights)  # those there were are of the pose before
        found = replace(found, alternatives=tuple(self._as_good(found, rivals)))
        undecided = any(one.like.mirrored and one.apart.open for one in rivals)
        return found.noting("of the part and its mirror image either may be seen") if undecided else found

    def _rivals(self, found: Location, sights: Sequence[Sight] | None) -> list[_Rival]:
        """Return the rivals that a found pose's own lines do not exclude; sights: as for `checked`."""
        pose = found.pose.world_from_part
        likely = [
            (like, contested)
            for like, contested in zip(self.part.likenesses, self.contested(found).tolist(), strict=True)
            if contested or not self.holds(found, pose @ like.motion, like.mirrored)
        ]
        if not likely:
            return []
        if sights is None or any(s.moved_px(s.drawn, pose) > _NEAR_PX for s in sights):
            sights = self._sights(self.part, pose)  # drawn elsewhere, they include lines that are hidden here
        own = Reading.of(sights, pose, near=_NEAR_PX)
        return [one for like, contested in likely if (one := self._rival(pose, like, own, contested)) is not None]

    def _as_good(self, found: Location, rivals: Sequence[_Rival]) -> list[Location]:
        """Return what refining rivals that nothing tells from a found pose gives, where it is about as good as that.

        Either the pose lacks lines that it alone has, or neither has lines in view that the other has not.
        """
        turned = [one for one in rivals if one.apart.open and not one.like.mirrored]
        open_ = [one for one in turned if one.contested or one.apart.untold]
        open_ = sorted(open_, key=lambda one: one.apart.shown - one.apart.others_shown)[:_REFINED]
        refined = [self._refined(one)[0] for one in open_]
        least = max(FOUND, found.quality - _AS_GOOD)
        return [one for one in refined if one.quality >= least and not far_looser(one, found)]

    def _refined(self, rival: _Rival) -> tuple[Location, Sequence[Sight]]:
        """Return the location that refining a rival's pose gives, and its lines."""
        near = replace(self.options, search_px=_LAID_PX)
        freedom = self._freedom(rival.like)
        return Refinement(self.part, self.photos, freedom, options=near, chosen=self.chosen).around(rival.pose)

    def prefers(self, one: Location, other: Location) -> bool:
        """Return whether the photos show the lines that only `one` has, and not those that only `other` has.

        What the fits have measured says so first, which costs next to nothing, and then the drawn lines that have room:
        among the others many do not show at the right pose, either.
        """
        if one is other:
            return False
        poses = one.pose.world_from_part, other.pose.world_from_part
        if self.holds(other, poses[0]) or not self.holds(one, poses[1]):
            return False
        mine, its = (Reading.of(self._sights(self.part, pose), pose, near=_NEAR_PX) for pose in poses)
        return told_apart(its, mine).against

    def holds(self, found: Location, other: Rigid, mirrored: bool = False) -> bool:
        """Return whether those lines of a found pose that another pose does not have are shown as often as the rest.

        Then the other pose need not be tried. mirrored: whether it is one of the mirror image. Its edges are projected
        without removing hidden ones, which is cheap; its contours, unknown until drawn, are assumed to be where the
        found pose has them. Both can only make fewer lines count as those of the found pose alone.
        """
        matches, part = found.matches, self._part(mirrored)
        every = np.arange(len(matches))[:: max(1, len(matches) // ASKED)]
        own = np.zeros(len(matches), bool)
        for number, photo in enumerate(self.photos):
            here = every[matches.photo[every] == number]
            view = photo.viewpoint
            edges = edge_points(part.scene, view.camera, view.camera_from_world @ other, apart_px=_DENSE_PX)
            contours = matches.q[(matches.chain < 0) & (matches.photo == number)]
            own[here] = away(matches.q[here], np.concatenate([edges, contours]))
        return shows_alike(own[every], matches.believed[every])

    def _rival(self, pose: Rigid, like: Likeness, own: Reading, contested: bool) -> _Rival | None:
        """Return a rival of a found pose, its lines pulled onto the photos' steps, with the evidence between the two.

        None where the found pose's own lines are shown in any case.
        """
        part, start = self._part(like.mirrored), pose @ like.motion
        sights = self._sights(part, start)
        if own.holds_against([s.project(start).q for s in sights]):
            return None
        end = attracted(sights, start, self._freedom(like), search_px=_LAID_PX)
        return _Rival(like, end, told_apart(own, Reading.of(sights, end, near=_NEAR_PX)), contested)

    def _part(self, mirrored: bool) -> Part:
        return self.part.mirrored if mirrored else self.part

    def _freedom(self, like: Likeness) -> Freedom:
        """Return the freedom of the part, or its mirror image, in another reading."""
        if self.freedom.full or self.freedom.frame == "world":
            return self.freedom
        return Freedom(like.motion.inv.adjoint() @ self.freedom.basis)

    def _sights(self, part: Part, pose: Rigid) -> list[Sight]:
        return drawn(part, self.photos, pose, self.options)


def far_looser(one: Location, other: Location) -> bool:
    """Return whether one pose's lines lie beside the photos' steps where the other's lie far closer to them."""
    return one.matches.scatter_px > max(LOOSE_PX, _CLOSER * other.matches.scatter_px)


def _mirrored(found: Location, apart: Apart) -> Location:
    hand = "is it the part of the other hand, or the photo mirrored?"
    return _doubted(found, f"the photos show the part's mirror image: {apart}; {hand}")


def _doubted(found: Location, why: str) -> Location:
    return replace(found, quality=min(found.quality, _DOUBTED), why=found.why.refused(Refusal.NOT_FOUND, why))
