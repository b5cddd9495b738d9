"""Which starts would only lead to poses that were refined before."""

from __future__ import annotations

from collections.abc import Sequence

from cadcam.geometry.rigid import Rigid
from cadcam.locate.attraction import attracted
from cadcam.locate.freedom import Freedom
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine import EdgeOptions
from cadcam.locate.sight import Sight

_SAME_PX = 0.5  # lines pulled this near to those of a pose are pulled to it


class Basins:
    """Refined poses, and the starts from which lines are pulled to them.

    To pull lines is a small part of the work of refining; they are drawn once for each pose, when first needed.
    """

    def __init__(self, part: Part, photos: Sequence[Photo], freedom: Freedom, options: EdgeOptions) -> None:
        self._part, self._photos, self._freedom, self._options = part, photos, freedom, options
        self._poses: list[Rigid] = []
        self._drawn: list[list[Sight]] = []

    def add(self, world_from_part: Rigid) -> None:
        """Remember a refined pose."""
        self._poses.append(world_from_part)

    def hold(self, start: Rigid, search_px: float) -> bool:
        """Return whether the lines of a start, looked for within search_px, come to lie on those of a pose."""
        self._drawn += [self._sights(pose) for pose in self._poses[len(self._drawn) :]]
        return any(self._leads(start, *to, search_px) for to in zip(self._poses, self._drawn, strict=True))

    def _leads(self, start: Rigid, pose: Rigid, sights: Sequence[Sight], search_px: float) -> bool:
        end = attracted(sights, start, self._freedom, search_px=search_px)
        return max(s.moved_px(end, pose) for s in sights) < _SAME_PX

    def _sights(self, pose: Rigid) -> list[Sight]:
        lengths = {"step_px": self._options.step_px, "reach_px": 2 * self._options.reach_px}
        return [Sight.of(self._part, photo, pose, **lengths) for photo in self._photos]
