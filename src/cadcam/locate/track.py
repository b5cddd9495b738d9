"""A part followed through pictures: each pose is the start of the next; what is lost is looked for again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import BadValue, NothingInView
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.locate.frames import Frame
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.locate import locate
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine import refine

_PATIENCE = 8  # frames between two searches without a start, once a part has been gone for long


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """Where the part was in one frame.

    how: "predicted" (from the last motion), "kept" (from the last pose), "recovered" (searched around the last pose, or
    around the start), "searched" (without any start), "lost". Of a lost frame the location is the best that was there;
    its `found` is False.
    """

    frame: Frame
    location: Location
    how: str

    @property
    def found(self) -> bool:
        """Return whether the part was found."""
        return self.location.found


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A frame of an earlier run: its index and world_from_part, None where the part was lost."""

    index: int
    world_from_part: Rigid | None


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

    start: world_from_part (mm) in the first frame, roughly; without it the part is searched for. Each frame starts from
    where the last motion leads (`velocity`; else from the last pose). Where that does not find the part, it is searched
    for around its last pose, then without a start (not where its motion is restricted); a part that stays away is
    searched for less and less often. Of poses that the part's symmetry allows, the one nearest to the last is taken.
    history: frames of a run that this one continues, as if there had been no break. A frame without contrast is a loss.
    Raises `NothingInView` where the start puts the part outside of the first photos.
    """
    if freedom is not FREE and start is None:
        raise BadValue("freedom", "given without a start", "a start to move from, or no freedom")
    memory = _Memory(_corners(part), start, velocity)
    for step in history:
        memory.keep(step.index, step.world_from_part)
    for frame in frames:
        how, location = _located(part, frame.photos, memory, freedom, frame.index)
        memory.keep(frame.index, location.pose.world_from_part if location.found else None)
        yield TrackedFrame(frame, location, how)


class _Memory:
    """What is known of the part's motion, and for how long it has been lost."""

    def __init__(self, corners: Array, start: Rigid | None, velocity: bool) -> None:
        self.last = start
        self.misses = 0
        self._corners = corners
        self._velocity = velocity
        self._steps: list[Step] = []

    @property
    def begins(self) -> bool:
        """Return whether no frame has been seen yet."""
        return not self._steps and not self.misses

    def keep(self, index: int, pose: Rigid | None) -> None:
        if pose is None:
            self.misses += 1
            return
        self.misses, self.last = 0, pose
        self._steps = [*self._steps[-1:], Step(index, pose)]

    def predicted(self, index: int) -> Rigid | None:
        """Return where constant velocity leads, None unless the part was found in the last two frames."""
        if not self._velocity or [s.index for s in self._steps] != [index - 2, index - 1]:
            return None
        before, last = (s.world_from_part for s in self._steps)
        assert before is not None
        assert last is not None
        ahead = last @ before.inv @ last  # in an endless chain of products rounding grows: a rotation has to stay one
        return Rigid(so3.nearest(ahead.rotation), ahead.translation)

    def tracking(self, index: int) -> bool:
        """Return whether the part was found in the frame before."""
        return bool(self._steps) and self._steps[-1].index == index - 1

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
    part: Part, photos: tuple[Photo, ...], memory: _Memory, freedom: Freedom, index: int
) -> tuple[str, Location]:
    """Return how and where the part was found, by the cheapest way that finds it; else the best of what was tried."""
    where = memory.last or Rigid()
    tried = [Location.nowhere(where, "not looked for")]
    for how, attempt in _ways(part, photos, memory, freedom, index):
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
            return how, memory.nearest(location)
        tried.append(location)
    return "lost", max(reversed(tried), key=lambda one: one.quality)


def _ways(
    part: Part, photos: tuple[Photo, ...], memory: _Memory, freedom: Freedom, index: int
) -> Iterator[tuple[str, Callable[[], Location]]]:
    """Yield the ways to find the part, cheapest first."""
    last, predicted = memory.last, memory.predicted(index)
    if predicted is not None:
        yield "predicted", lambda: refine(part, photos, predicted, freedom=freedom)
    if last is not None and memory.tracking(index):
        yield "kept", lambda: refine(part, photos, last, freedom=freedom)
    if last is not None:
        yield "recovered", lambda: locate(part, photos, last, freedom=freedom)
    if freedom is FREE and (last is None or memory.search_is_due()):
        yield "searched", lambda: locate(part, photos, freedom=freedom)


def _corners(part: Part) -> Array:
    """Return the corners (8, 3) of the part's bounding box, mm."""
    low, high = part.scene.mesh.bounds
    pick = np.indices((2, 2, 2)).reshape(3, -1).T.astype(bool)
    return np.asarray(np.where(pick, high, low), np.float64)
