"""Which starts would only lead to poses that were refined before."""

from __future__ import annotations

from collections.abc import Sequence

from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.lines.attraction import attracted
from cadcam.locate.lines.sight import Sight
from cadcam.locate.location import Location

_WORTH = 0.25  # quality of a pose that half of the lines agree with: to others hardly more than one start leads
_SAME_PX = 0.5  # lines pulled this near to those of a pose are pulled to it


class Basins:
    """Refined poses, and the starts from which lines are pulled to them: a small part of the work of refining."""

    def __init__(self, freedom: Freedom) -> None:
        self._freedom = freedom
        self._known: list[tuple[Rigid, Sequence[Sight]]] = []

    def add(self, location: Location, sights: Sequence[Sight]) -> None:
        """Remember a refined pose, if enough speaks for it, and the lines as seen there."""
        if location.quality > _WORTH:
            self._known.append((location.pose.world_from_part, sights))

    def sights(self, pose: Rigid) -> Sequence[Sight] | None:
        """Return the lines as seen at a pose that was refined, None where they were not remembered."""
        return next((sights for known, sights in self._known if known is pose), None)

    def hold(self, start: Rigid, search_px: float) -> bool:
        """Return whether the lines of a start, looked for within search_px, come to lie on those of a known pose."""
        return any(self._leads(start, *known, search_px) for known in self._known)

    def _leads(self, start: Rigid, pose: Rigid, sights: Sequence[Sight], search_px: float) -> bool:
        end = attracted(sights, start, self._freedom, search_px=search_px)
        return max(s.moved_px(end, pose) for s in sights) < _SAME_PX
