"""Whether the photos show another reading of what was found: the part beside its place, or its mirror image.

A part is nearly like itself one bay on, or turned over, and like its mirror image (`locate.views.likeness`). In each of
these readings most lines are there; no share of missing lines tells them from a part that is partly hidden. Lines that
only one of them has do (`locate.quality.apart`). Of a right pose its own lines show about as well as those that both
have: that is asked first, of what the fit was told, and few other readings need be drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.lines.attraction import attracted
from cadcam.locate.lines.sight import Sight
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.quality.apart import Apart, Reading, away, shows_alike, told_apart
from cadcam.locate.quality.quality import ASKED
from cadcam.locate.refine.options import EdgeOptions
from cadcam.locate.refine.refine import Refinement
from cadcam.locate.views.likeness import Likeness

_DOUBTED = 0.45  # quality of a pose where the photos show another reading
_BELIEVED = 0.3  # weight in the fit from which on a sample shows
_NEAR_PX = 2.0  # how near to lines their steps must be, of a pose that is good to a pixel
_ROUNDS = 3  # times that a pose is left for another one
_LAID_PX = 5.0  # how far lines may be off that are laid over others


@dataclass(frozen=True, slots=True, eq=False)
class _Rival:
    """Another reading of a found pose, where it puts the part, or the mirror image, and what tells it from that."""

    like: Likeness
    pose: Rigid
    apart: Apart


@dataclass(frozen=True, slots=True, eq=False)
class Rivals:
    """What is asked of a found pose: the part in photos, how it may move, and constraints that its search met."""

    part: Part
    photos: Sequence[Photo]
    freedom: Freedom
    options: EdgeOptions
    chosen: int

    def beside(self, found: Location, sights: Sequence[Sight] | None = None) -> Location:
        """Return a found pose, the one that the photos show rather than it, or that they show the mirror image.

        sights: the part's lines as drawn about there, if they were. Where photos do not tell the part from its mirror
        image, the reason says so.
        """
        read: list[_Rival] = []
        for _ in range(_ROUNDS):
            pose = found.pose.world_from_part
            likely = [like for like in self.part.likenesses if not self.holds(found, pose @ like.motion, like.mirrored)]
            if not likely:
                return found
            if sights is None or any(s.moved_px(s.drawn, pose) > _NEAR_PX for s in sights):
                sights = self._sights(self.part, pose)  # drawn elsewhere they have lines that are hidden here
            own = Reading.of(sights, pose, near=_NEAR_PX)
            every = (self._read(pose @ like.motion, like, own) for like in likely)
            read = [one for one in every if one is not None]
            against = [one for one in read if one.apart.against]
            if not against:
                break
            best = max(against, key=lambda one: one.apart.others_shown - one.apart.shown)
            if best.like.mirrored:
                return _mirrored(found, best.apart)
            near = replace(self.options, search_px=_LAID_PX)
            asked = Refinement(self.part, self.photos, self._freedom(best.like), options=near, chosen=self.chosen)
            other, sights = asked.around(best.pose)
            if not other.found:
                return _doubted(found, f"elsewhere the part is shown as well: {best.apart}")
            found = other
        undecided = any(one.like.mirrored and one.apart.open for one in read)
        either = "; of the part and its mirror image either may be seen"
        return replace(found, reason=found.reason + either) if undecided else found

    def rather(self, one: Location, other: Location) -> bool:
        """Return whether of two found poses the lines that only the one has show, and those of the other do not."""
        if one is other:
            return False
        poses = one.pose.world_from_part, other.pose.world_from_part
        return not self.holds(other, poses[0]) and self.holds(one, poses[1])

    def holds(self, found: Location, other: Rigid, mirrored: bool = False) -> bool:
        """Return whether lines of a found pose that none at another pose is near to show about as the rest of them do.

        mirrored: whether that is one of the mirror image. Asked are its edges, hidden ones too, for these cost little;
        contours, which nobody knows before they are drawn, it is taken to have where the found pose has them.
        """
        matches, part = found.matches, self._part(mirrored)
        every = np.arange(len(matches))[:: max(1, len(matches) // ASKED)]
        own = np.zeros(len(matches), bool)
        for number, photo in enumerate(self.photos):
            here = every[matches.photo[every] == number]
            contours = matches.q[(matches.chain < 0) & (matches.photo == number)]
            own[here] = away(matches.q[here], np.concatenate([_edges_in(photo, part, other), contours]))
        shown = np.isfinite(matches.offset) & (matches.weight > _BELIEVED)
        return shows_alike(own[every], shown[every])

    def _read(self, start: Rigid, like: Likeness, own: Reading) -> _Rival | None:
        """Return another reading, its lines pulled onto the photos' steps, and what tells it from the found one.

        None where the found one's own lines are there in any case.
        """
        part = self._part(like.mirrored)
        sights = self._sights(part, start)
        if own.holds_against([s.project(start).q for s in sights]):
            return None
        end = attracted(sights, start, self._freedom(like), search_px=_LAID_PX)
        return _Rival(like, end, told_apart(own, Reading.of(sights, end, near=_NEAR_PX)))

    def _part(self, mirrored: bool) -> Part:
        return self.part.mirrored if mirrored else self.part

    def _freedom(self, like: Likeness) -> Freedom:
        """Return how the part, or its mirror image, may move in another reading."""
        if self.freedom is FREE or self.freedom.frame == "world":
            return self.freedom
        return Freedom(like.motion.inv.adjoint() @ self.freedom.basis)

    def _sights(self, part: Part, pose: Rigid) -> list[Sight]:
        sizes = {"step_px": self.options.step_px, "reach_px": 2 * self.options.reach_px}
        return [Sight.of(part, photo, pose, **sizes) for photo in self.photos]


def _edges_in(photo: Photo, part: Part, pose: Rigid) -> Array:
    """Return points (n, 2) px along all edges of a part at a pose, hidden ones too; nan where a photo shows nothing."""
    view = photo.viewpoint
    return view.camera.project(view.camera_from_world @ pose @ part.edge_points)


def _mirrored(found: Location, apart: Apart) -> Location:
    hand = "is it the part of the other hand, or the photo mirrored?"
    return _doubted(found, f"the photos show the part's mirror image: {apart}; {hand}")


def _doubted(found: Location, why: str) -> Location:
    return replace(found, quality=min(found.quality, _DOUBTED), reason=f"not found: {why} ({found.reason})")
