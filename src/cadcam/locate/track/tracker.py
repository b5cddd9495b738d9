"""A part tracked through frames: its texture and its motion predict the pose; a lost part is searched for again.

A frame is searched only as far around the predicted lines as their covariance says: farther edges, as of print or of a
shadow, cannot pull the part away. Where the part's faces have texture that the model lacks (`locate.track.texture`), it
determines the pose together with the edges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue, NothingInView, UnusablePhoto
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect, expect_flag, expect_several
from cadcam.locate.evidence import Evidence
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.in_photos import ALIKE, locate_part
from cadcam.locate.location import FOUND, Disagreement, Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.reason import Reason, Refusal
from cadcam.locate.refine.options import EDGES
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.search.lying import Lying
from cadcam.locate.track.frames import Frame
from cadcam.locate.track.motion import MotionFilter
from cadcam.locate.track.texture import Followed, Texture
from cadcam.locate.uncertainty import weakest_direction
from cadcam.locate.usable import faults_in
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange

_PATIENCE = 8  # frames between two searches without a start, once a part has been lost for long
_SIGMAS, _BESIDE = 3.0, 1.0  # search range around predicted lines: sds, and px added for painted lines
_LEAST_PX, _MOST_PX = 2.0, EDGES.search_px
_FAR_PX, _CLEAR = 16.0, 0.7  # a pose farther than this from the last one needs this quality to be believed
_ANYWHERE = ("followed", "searched")  # ways of finding the part that do not depend on the last pose
# Constraints credited to a pose that is known to some px from the motion, as a fit anywhere else would not have been
# accepted; and to one by texture, as edges agree there that were not used to fit it.
_FORETOLD, _FOLLOWED = -2, -5
_BETTER = 0.2  # quality by which a fit to edges alone must be better to show that the texture has left the part
_ELSEWHERE = Reason("edges are elsewhere than print leads", Refusal.NOT_FOUND)
_HELD = 0.3  # least quality by its edges of a part that is held by its texture


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TrackedFrame:
    """The pose of the part in one frame.

    location: from this frame's photos and, where "followed", the texture learned in earlier frames. filtered: from all
    frames so far (`locate.track.motion`), steadier, and better where a frame shows little, but lagging behind when the
    motion changes; None where the part was lost. how: "followed" (by its texture), "predicted" (near the pose predicted
    from its motion), "kept" (around the last pose), "recovered" (searched for around the last pose or the start),
    "searched" (without any start), "lost": the location is then the best candidate, with `found` False.
    """

    frame: Frame
    location: Location
    how: str
    filtered: PoseEstimate | None = None

    @property
    def found(self) -> bool:
        """Return whether the part was found."""
        return self.location.found

    def __repr__(self) -> str:
        return f"TrackedFrame({self.frame.index}, {self.how}, {self.location})"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LoggedFrame(Brief):
    """A frame of an earlier run: its index, the pose found (unfiltered; None where the part was lost), and how.

    photos: of the frame; without them the texture of the part is learned anew.
    """

    index: int
    pose: PoseEstimate | None
    how: str = ""
    photos: tuple[Photo, ...] = ()


def track_part(
    part: Part,
    frames: Iterable[Frame],
    start: Rigid | None = None,
    *,
    freedom: Freedom = FREE,
    velocity: bool = True,
    texture: bool = True,
    views: ViewRange = WHOLE_SPHERE,
    history: Iterable[LoggedFrame] = (),
) -> Iterator[TrackedFrame]:
    """Yield the pose of the part in each frame, one by one as they are asked for.

    start: rough world_from_part (mm) in the first frame; without it the part is searched for. In each frame it is
    looked for where its texture predicts it (`texture`), or near where its motion does (`velocity`: at constant
    velocity; else where it was). Where that fails it is searched for around its last pose, then without a start, within
    `views` (unless `freedom` restricts its motion), less and less often the longer it is lost. Of the poses that are
    equivalent by the part's symmetry, the one nearest to the last is taken.
    history: frames of a run that this one continues as if there had been no break. In a frame without contrast the part
    is lost. Raises `NothingInView` where the start puts the part outside of the first photos, `BadValue` for a plane of
    `views` that these do not show, or on which the part cannot lie as stated.
    """
    tracker = Tracker(part, start, freedom=freedom, velocity=velocity, texture=texture, views=views)
    expect_several(frames, "frames", Frame)
    expect_several(history, "history", LoggedFrame)
    for step in history:
        tracker.recall(step)
    for frame in frames:
        yield tracker.next(frame)


class Tracker:
    """Tracks a part frame by frame; arguments as for `track_part`."""

    def __init__(
        self,
        part: Part,
        start: Rigid | None,
        *,
        freedom: Freedom,
        velocity: bool,
        texture: bool,
        views: ViewRange,
    ) -> None:
        expect(part, "part", Part)
        expect_motion(start, "start", optional=True)
        expect(views, "views", ViewRange)
        expect(freedom, "freedom", Freedom)
        expect_flag(velocity, "velocity")
        expect_flag(texture, "texture")
        if not freedom.full and start is None:
            raise BadValue("freedom", "given without a start", "a start to move from, or no freedom")
        self._part, self._freedom, self._views = part, freedom, views
        self._memory = _Memory(part.scene.mesh.box_corners, start, velocity)
        self._texture = Texture(part) if texture else None

    def next(self, frame: Frame) -> TrackedFrame:
        """Return the pose of the part in the next frame."""
        expect(frame, "frame", Frame)
        followed = self._followed(frame.index, frame.photos)
        faults = {k: _of_frame(said, frame) for k, said in faults_in(frame.photos).items()}
        usable = [k for k in range(len(frame.photos)) if k not in faults]
        if faults and usable:
            how, location = self._located(frame.only(usable), followed, whole=False)
            location = _without(location.numbered(usable), frame, faults)
        else:
            how, location = self._located(frame, followed, whole=True)
        step = LoggedFrame(frame.index, location.pose if location.found else None, how, frame.photos)
        return TrackedFrame(frame, location, how, self._keep(step, followed))

    def recall(self, step: LoggedFrame) -> None:
        """Take in a frame of an earlier run instead of tracking it."""
        expect(step, "frame of the history", LoggedFrame)
        self._keep(step, None if step.pose is None else self._followed(step.index, step.photos))

    def _followed(self, index: int, photos: tuple[Photo, ...]) -> Followed | None:
        """Return the pose by the part's texture, None unless the part was found in the frame before."""
        predicted = self._memory.predicted(index)
        if self._texture is None or predicted is None or not photos:
            return None
        return self._texture.follow(photos, predicted.world_from_part, self._freedom)

    def _located(self, frame: Frame, followed: Followed | None, *, whole: bool) -> tuple[str, Location]:
        """Return how and where the part was found, by the cheapest way that finds it; else the best candidate.

        whole: whether the frame has the photos of all cameras, which show where they look.
        """
        memory = self._memory
        if memory.begins and frame.photos and whole:
            Lying.of(self._part, frame.photos, self._views)  # what is wrong with it is so in every frame
        where = memory.last or Rigid()
        tried = [Location.nowhere(where, Reason("not looked for"))]
        for how, attempt in self._ways(frame, followed):
            try:
                location = attempt()
            except NothingInView as error:
                if memory.begins and whole:  # the start was the caller's
                    raise
                tried[0] = Location.nowhere(where, Reason(str(error)))
                continue
            except UnusablePhoto as error:
                tried[0] = Location.nowhere(where, Reason(_of_frame(str(error), frame)))
                continue
            if location.found:
                location = self._reasoned(memory.nearest(location), location, frame.photos)
                if how in _ANYWHERE or location.quality >= _CLEAR or not memory.left(location.pose, frame.photos):
                    return how, location
                location = location.uncertain(f"far from where the part was, which takes a quality of {_CLEAR}")
            tried.append(location)
        return "lost", max(reversed(tried), key=lambda one: one.quality)

    def _reasoned(self, nearest: Location, found: Location, photos: tuple[Photo, ...]) -> Location:
        """Return the pose nearest to the last; where it only looks the same as the found one, with that one's reason.

        The reason's direction that is least certain is along the axes of the part, which the two have elsewhere.
        """
        if nearest.why.why != ALIKE.why:  # it may have notes
            return nearest
        return replace(nearest, why=found.why.knowing(self._known(nearest.pose, photos)))

    def _known(self, pose: PoseEstimate, photos: tuple[Photo, ...]) -> str:
        """Return in words how well a pose of the part is known."""
        return weakest_direction(pose, self._part.aspects.centre, photos)

    def _ways(self, frame: Frame, followed: Followed | None) -> Iterator[tuple[str, Callable[[], Location]]]:
        """Yield the ways of finding the part in a frame, cheapest first, each with what tries it."""
        part, photos, freedom = self._part, frame.photos, self._freedom
        last, predicted = self._memory.last, self._memory.predicted(frame.index)
        if followed is not None:
            yield "followed", lambda: self._by_texture(photos, followed)
        if predicted is not None:
            yield "predicted", lambda: self._near_predicted(photos, predicted)
        if last is not None and self._memory.tracking(frame.index):
            yield "kept", lambda: refine_pose(part, photos, last, freedom=freedom)
        if last is not None:
            yield "recovered", lambda: locate_part(part, photos, last, freedom=freedom)
        if freedom.full and (last is None or self._memory.search_is_due()):
            yield "searched", lambda: locate_part(part, photos, freedom=freedom, views=self._views)

    def _near_predicted(self, photos: tuple[Photo, ...], predicted: PoseEstimate) -> Location:
        """Return what is found close to the pose predicted by the motion, without searching farther."""
        reach_px = self._memory.reach_px(predicted, photos)
        given = _FORETOLD if reach_px < _MOST_PX else 0
        return self._refined(photos, predicted.world_from_part, reach_px, chosen=given)

    def _by_texture(self, photos: tuple[Photo, ...], followed: Followed) -> Location:
        """Return the pose from texture and nearby edges together.

        Texture that is found again shows that this is still the part; so the edges need only not contradict it.
        """
        there = followed.evidence
        start = there.world_from_part
        reach_px = self._memory.reach_px(PoseEstimate(start, there.covariance), photos)
        location = self._refined(photos, start, reach_px, evidence=[there], chosen=_FOLLOWED)
        if location.quality < _CLEAR:
            alone = self._refined(photos, start, reach_px)
            if alone.quality > location.quality + _BETTER:
                return replace(location, quality=0.0, why=_ELSEWHERE)
        if location.disputed:  # print was learned by the cameras that disagree: it tells nothing of them
            return replace(location, quality=0.0)
        surer = replace(location.pose, from_noise=followed.fused(location.pose.from_noise))
        location = replace(location, pose=surer, why=location.why.knowing(self._known(surer, photos)))
        if not _HELD <= location.quality < FOUND:
            return location
        why = Reason(f"held by {followed.found} patches of print: {location.why.bare}")
        return replace(location, quality=FOUND, why=why)

    def _refined(
        self,
        photos: tuple[Photo, ...],
        start: Rigid,
        reach_px: float,
        *,
        evidence: Sequence[Evidence] = (),
        chosen: int = 0,
    ) -> Location:
        """Return the pose refined near a good start, by edges within reach alone; arguments as for `refine_pose`."""
        return refine_pose(
            self._part,
            photos,
            start,
            freedom=self._freedom,
            evidence=evidence,
            options=replace(EDGES, search_px=reach_px),
            chosen=chosen,
            wider=False,
        )

    def _keep(self, step: LoggedFrame, followed: Followed | None) -> PoseEstimate | None:
        """Take in a frame; return the filtered pose, None where the part was lost."""
        if self._texture is not None and step.photos:
            misled = followed is not None and step.how != "followed"
            if step.pose is None or misled:
                self._texture.forget()
            if step.pose is not None:
                self._texture.keep(step.photos, step.pose, None if misled else followed)
        return self._memory.keep(step.index, step.pose)


class _Memory:
    """The last pose, the motion of the part, and for how long it has been lost."""

    def __init__(self, corners: Array, start: Rigid | None, velocity: bool) -> None:
        self.last = start
        self.misses = 0
        self._corners = corners
        centre = corners.mean(axis=0)
        self._motion = MotionFilter(centre, float(np.linalg.norm(corners - centre, axis=1).max()), velocity=velocity)
        self._found_in: int | None = None

    @property
    def begins(self) -> bool:
        """Return whether no frame has been taken in yet."""
        return self._found_in is None and not self.misses

    def keep(self, index: int, pose: PoseEstimate | None) -> PoseEstimate | None:
        """Take in a frame; return the filtered pose, None where the part was lost."""
        if pose is None:
            self.misses += 1
            self._motion.forget()
            return None
        self.misses, self.last, self._found_in = 0, pose.world_from_part, index
        return self._motion.measured(index, pose)

    def predicted(self, index: int) -> PoseEstimate | None:
        """Return the pose predicted by the motion, None unless the part was found in the frame before."""
        return self._motion.predicted(index)

    def tracking(self, index: int) -> bool:
        """Return whether the part was found in the frame before."""
        return self._found_in == index - 1

    def reach_px(self, predicted: PoseEstimate, photos: Sequence[Photo]) -> float:
        """Return how far (px) from the lines of a predicted pose edges are searched for."""
        spread = max(_spread_px(self._corners, predicted, photo) for photo in photos)
        return float(np.clip(_SIGMAS * spread + _BESIDE, _LEAST_PX, _MOST_PX))

    def left(self, pose: PoseEstimate, photos: Sequence[Photo]) -> bool:
        """Return whether a pose is far, in all photos, from the last one found."""
        if self._found_in is None or self.last is None:
            return False
        return all(_moved_px(self._corners, self.last, pose.world_from_part, photo) > _FAR_PX for photo in photos)

    def search_is_due(self) -> bool:
        """Return whether to search without a start: after 2, 4, 8, 16, 24 ... misses, as each search may err."""
        return self.misses > 1 and (self.misses % _PATIENCE == 0 or self.misses & (self.misses - 1) == 0)

    def nearest(self, location: Location) -> Location:
        """Return whichever of the found pose and its alternatives is nearest to the last pose."""
        if self.last is None:
            return location
        was = self.last @ self._corners
        found = [location, *(other for other in location.alternatives if other.found)]
        return min(found, key=lambda one: float(np.abs(one.pose.world_from_part @ self._corners - was).sum()))


def _without(location: Location, frame: Frame, faults: Mapping[int, str]) -> Location:
    """Return a location by the other photos of a frame, saying which were left out, and for what faults."""
    gone = tuple(Disagreement(k, frame.photos[k].viewpoint.name, np.nan, left_out=True) for k in faults)
    told = location.noting(f"left out: {'; '.join(faults.values())}")
    return replace(told, disagreements=(*told.disagreements, *gone))


def _of_frame(said: str, frame: Frame) -> str:
    """Return what is said of a photo, which is called as its camera, with the name of its file or frame."""
    for name, photo in zip(frame.names, frame.photos, strict=False):  # a frame may be without names
        said = said.replace(f"photo {photo.viewpoint.name!r}", f"photo {name!r}")
    return said


def _moved_px(corners: Array, one: Rigid, other: Rigid, photo: Photo) -> float:
    """Return the largest distance (px) between a corner's (N, 3) mm images at two poses, of those in the photo."""
    place = photo.camera_from_world
    apart = np.linalg.norm(
        np.subtract(*(photo.camera.project((place @ pose) @ corners) for pose in (one, other))), axis=1
    )
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else np.inf


def _spread_px(corners: Array, pose: PoseEstimate, photo: Photo) -> float:
    """Return the largest sd (px) of the images of the corners (N, 3) mm; inf where not all are in the photo."""
    camera_from_part, pose = photo.camera_from_world @ pose.world_from_part, pose.determined
    _, J = photo.camera.project_with_jacobian(camera_from_part @ corners)
    J = J[np.isfinite(J).all(axis=(1, 2))] @ camera_from_part.rotation
    if len(J) < len(corners):
        return np.inf
    S = J @ pose.point_covariance(corners) @ J.swapaxes(1, 2)
    return float(np.sqrt(np.linalg.eigvalsh(S).max()))
