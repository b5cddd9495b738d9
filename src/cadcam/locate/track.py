"""A part followed through pictures: its motion foretells where it will be; what is lost is looked for again.

Where the motion is even, a frame is searched only as far around the foretold lines as their covariance says: what lies
farther, print or a shadow beside an edge, cannot pull the part away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import os
import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry.rigid import Rigid
from cadcam.locate.frames import Frame
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.locate import locate
from cadcam.locate.location import Location
from cadcam.locate.motion import Motion
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine import EDGES, refine
from cadcam.locate.texture import Followed, Texture

_PATIENCE = 8  # frames between two searches without a start, once a part has been gone for long
_SIGMAS, _BESIDE = 3.0, 1.0  # how far around foretold lines the photo's are looked for: sds, and px for lines of paint
_LEAST_PX, _MOST_PX = 2.0, EDGES.search_px
_FAR_PX, _CLEAR, _UNCERTAIN = 16.0, 0.7, 0.45  # so far from its last place a part must be clear, else it is this
_BY_PRINT = -5  # constraints of a place that print tells: edges there are met without a fit
_FORETOLD = -2  # constraints that a place foretold to some px gives back: a fit anywhere else would not count


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """Where the part was in one frame.

    location: by this frame's photos alone. filtered: by all frames so far (`locate.motion`), steadier and better where
    a frame shows little, but late by a share of what the motion changed; None where the part was lost. how: "predicted"
    (near where the motion led), "kept" (around the last pose), "recovered" (searched around the last pose, or around
    the start), "searched" (without any start), "lost". Of a lost frame the location is the best that was there; its
    `found` is False.
    """

    frame: Frame
    location: Location
    how: str
    filtered: PoseEstimate | None = None

    @property
    def found(self) -> bool:
        """Return whether the part was found."""
        return self.location.found


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A frame of an earlier run: its index and where it showed the part (unfiltered), None where that was lost."""

    index: int
    pose: PoseEstimate | None
    how: str = ""
    photos: tuple[Photo, ...] = ()


def track(
    part: Part,
    frames: Iterable[Frame],
    start: Rigid | None = None,
    *,
    freedom: Freedom = FREE,
    velocity: bool = True,
    history: Sequence[Step] = (),
) -> Iterator[TrackedFrame]:
    """Yield where the part is in each frame, one by one as they are asked for.

    start: world_from_part (mm) in the first frame, roughly; without it the part is searched for. A frame is looked at
    near where the motion so far leads (`velocity`: at constant velocity; else where it was). Where that does not find
    the part, it is searched for around its last pose, then without a start (not where its motion is restricted); a part
    that stays away is searched for less and less often. Of poses that the part's symmetry allows, the one nearest to
    the last is taken.
    history: frames of a run that this one continues, as if there had been no break. A frame without contrast is a loss.
    Raises `NothingInView` where the start puts the part outside of the first photos.
    """
    if freedom is not FREE and start is None:
        raise BadValue("freedom", "given without a start", "a start to move from, or no freedom")
    memory = _Memory(part, start, freedom, velocity)
    for step in history:
        memory.keep(step, memory.followed(step.index, step.photos))
    for frame in frames:
        followed = memory.followed(frame.index, frame.photos)
        how, location = _located(part, frame.photos, memory, freedom, frame.index, followed)
        step = Step(frame.index, location.pose if location.found else None, how, frame.photos)
        yield TrackedFrame(frame, location, how, memory.keep(step, followed))


class _Memory:
    """What is known of the part's motion, and for how long it has been lost."""

    def __init__(self, part: Part, start: Rigid | None, freedom: Freedom, velocity: bool) -> None:
        corners = _corners(part)
        self.last = start
        self._freedom = freedom
        self._texture = Texture(part)
        self.misses = 0
        self._corners = corners
        centre = corners.mean(axis=0)
        self._motion = Motion(centre, float(np.linalg.norm(corners - centre, axis=1).max()), velocity=velocity)
        self._found_in: int | None = None

    @property
    def begins(self) -> bool:
        """Return whether no frame has been seen yet."""
        return self._found_in is None and not self.misses

    def keep(self, step: Step, followed: Followed | None) -> PoseEstimate | None:
        """Take up a frame; return where the part is by all frames so far, None where it was lost."""
        if step.pose is None:
            self.misses += 1
            self._motion.forget()
            self._texture.forget()
            return None
        self.misses, self.last, self._found_in = 0, step.pose.world_from_part, step.index
        if followed is not None and step.how != "followed":  # edges and print disagree
            self._texture.forget()
            followed = None
        if step.photos:
            self._texture.keep(step.photos, step.pose, followed)
        return self._motion.measured(step.index, step.pose)

    def followed(self, index: int, photos: tuple[Photo, ...]) -> Followed | None:
        """Return where the print on the part leads, None unless the part was found in the frame before."""
        predicted = self.predicted(index)
        if predicted is None or not photos or self.last is None:
            return None
        return self._texture.follow(photos, predicted.world_from_part, self._freedom)

    def predicted(self, index: int) -> PoseEstimate | None:
        """Return where the motion leads, None unless the part was found in the frame before."""
        return self._motion.predicted(index)

    def tracking(self, index: int) -> bool:
        """Return whether the part was found in the frame before."""
        return self._found_in == index - 1

    def reach_px(self, predicted: PoseEstimate, photos: Sequence[Photo]) -> float:
        """Return how far from a foretold pose's lines the photos' may lie."""
        spread = max(_spread_px(self._corners, predicted, photo) for photo in photos)
        return float(np.clip(_SIGMAS * spread + _BESIDE, _LEAST_PX, _MOST_PX))

    def left(self, pose: PoseEstimate, photos: Sequence[Photo]) -> bool:
        """Return whether a pose is far, in all photos, from where the part was last found."""
        if self._found_in is None or self.last is None:
            return False
        return all(_moved_px(self._corners, self.last, pose.world_from_part, photo) > _FAR_PX for photo in photos)

    def search_is_due(self) -> bool:
        """Return whether to search without a start: after 2, 4, 8, 16, 24 ... misses; each has a chance to be wrong."""
        return self.misses > 1 and (self.misses % _PATIENCE == 0 or self.misses & (self.misses - 1) == 0)

    def nearest(self, location: Location) -> Location:
        """Return the found pose, this or an alternative of it, that is nearest to the last one."""
        if self.last is None:
            return location
        was = self.last @ self._corners
        found = [location, *(other for other in location.alternatives if other.found)]
        return min(found, key=lambda one: float(np.abs(one.pose.world_from_part @ self._corners - was).sum()))


def _located(
    part: Part, photos: tuple[Photo, ...], memory: _Memory, freedom: Freedom, index: int, followed: Followed | None
) -> tuple[str, Location]:
    """Return how and where the part was found, by the cheapest way that finds it; else the best of what was tried."""
    where = memory.last or Rigid()
    tried = [Location.nowhere(where, "not looked for")]
    for how, attempt in _ways(part, photos, memory, freedom, index, followed):
        try:
            location = attempt()
        except NothingInView as error:
            if memory.begins:  # the caller's start, not ours
                raise
            tried[0] = Location.nowhere(where, str(error))
            continue
        except BadValue as error:  # a picture without contrast
            tried[0] = Location.nowhere(where, str(error))
            continue
        if location.found:
            location = memory.nearest(location)
            if how == "searched" or location.quality >= _CLEAR or not memory.left(location.pose, photos):
                return how, location
            why = f"not certain: far from where the part was, which takes a quality of {_CLEAR} ({location.reason})"
            location = replace(location, quality=_UNCERTAIN, reason=why)
        tried.append(location)
    return "lost", max(reversed(tried), key=lambda one: one.quality)


def _ways(
    part: Part, photos: tuple[Photo, ...], memory: _Memory, freedom: Freedom, index: int, followed: Followed | None
) -> Iterator[tuple[str, Callable[[], Location]]]:
    """Yield the ways to find the part, cheapest first."""
    last, predicted = memory.last, memory.predicted(index)
    if followed is not None and predicted is not None:
        yield "followed", lambda: _by_print(part, photos, followed, predicted, memory, freedom)
    if predicted is not None:
        yield "predicted", lambda: _foretold(part, photos, predicted, memory.reach_px(predicted, photos), freedom)
    if last is not None and memory.tracking(index):
        yield "kept", lambda: refine(part, photos, last, freedom=freedom)
    if last is not None:
        yield "recovered", lambda: locate(part, photos, last, freedom=freedom)
    if freedom is FREE and (last is None or memory.search_is_due()):
        yield "searched", lambda: locate(part, photos, freedom=freedom)


def _foretold(
    part: Part, photos: tuple[Photo, ...], predicted: PoseEstimate, reach_px: float, freedom: Freedom
) -> Location:
    """Return what lies near a foretold pose, and nothing farther away."""
    options = replace(EDGES, search_px=reach_px)
    given = _FORETOLD if reach_px < _MOST_PX else 0
    return refine(part, photos, predicted.world_from_part, freedom=freedom, options=options, chosen=given, wider=False)


def _by_print(
    part: Part,
    photos: tuple[Photo, ...],
    followed: Followed,
    like: PoseEstimate,
    memory: _Memory,
    freedom: Freedom,
) -> Location:
    """Return what lies near where print leads, and where that and the print say the part is."""
    seen = followed.evidence
    foretold = replace(like, world_from_part=seen.world_from_part, from_noise=seen.covariance)
    options = replace(EDGES, search_px=memory.reach_px(foretold, photos))
    location = refine(
        part,
        photos,
        seen.world_from_part,
        freedom=freedom,
        evidence=[seen],
        options=options,
        chosen=_BY_PRINT,
        wider=False,
    )
    y, _ = seen.rows(photos[0], location.pose.world_from_part)
    if os.environ.get("VID_DEBUG"):
        print("print", followed.number, followed.found, "chi2 %.1f" % (y @ y), "reach %.1f" % options.search_px, "q %.2f" % location.quality, "S mm", np.sqrt(np.diag(followed.alone)[:3]).round(2), "told", np.sqrt(np.diag(seen.covariance)[:3]).round(2))
    pose = replace(location.pose, from_noise=followed.told(location.pose.from_noise))
    return replace(location, pose=pose)


def _moved_px(corners: Array, one: Rigid, other: Rigid, photo: Photo) -> float:
    """Return the largest distance (px) between the corners (N, 3) mm at two poses, of those that a photo images."""
    place = photo.viewpoint.camera_from_world
    apart = np.linalg.norm(
        np.subtract(*(photo.camera.project((place @ pose) @ corners) for pose in (one, other))), axis=1
    )
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else np.inf


def _spread_px(corners: Array, pose: PoseEstimate, photo: Photo) -> float:
    """Return the largest sd (px) of the corners (N, 3) mm in a photo, of those that it can see."""
    camera_from_part = photo.viewpoint.camera_from_world @ pose.world_from_part
    _, J = photo.camera.project_with_jacobian(camera_from_part @ corners)
    J = J[np.isfinite(J).all(axis=(1, 2))] @ camera_from_part.rotation
    if len(J) < len(corners):
        return np.inf
    S = J @ pose.point_covariance(corners) @ J.swapaxes(1, 2)
    return float(np.sqrt(np.linalg.eigvalsh(S).max()))


def _corners(part: Part) -> Array:
    """Return the corners (8, 3) of the part's bounding box, mm."""
    low, high = part.scene.mesh.bounds
    pick = np.indices((2, 2, 2)).reshape(3, -1).T.astype(bool)
    return np.asarray(np.where(pick, high, low), np.float64)
