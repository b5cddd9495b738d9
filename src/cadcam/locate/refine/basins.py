"""The basins of refined poses: which starts would only lead to these again."""

from __future__ import annotations

from collections.abc import Sequence

from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.lines.attraction import attracted
from cadcam.locate.lines.sight import Sight
from cadcam.locate.location import Location

_WORTH = 0.25  # least quality of a pose that is worth remembering: to others hardly more than one start leads
_SAME_PX = 0.5  # lines pulled this near to those of a pose are in its basin


class Basins:
    """Refined poses, and the starts whose lines are pulled onto theirs, which is far cheaper to test than to refine."""

    def __init__(self, freedom: Freedom) -> None:
        self._freedom = freedom
        self._known: list[tuple[Rigid, Sequence[Sight]]] = []

    def add(self, location: Location, sights: Sequence[Sight]) -> None:
        """Remember a refined pose, if its quality suffices, and the lines drawn there."""
        if location.quality > _WORTH:
            self._known.append((location.pose.world_from_part, sights))

    def sights(self, pose: Rigid) -> Sequence[Sight] | None:
        """Return the lines drawn at a refined pose, None where they were not remembered."""
        return next((sights for known, sights in self._known if known is pose), None)

    def hold(self, start: Rigid, search_px: float) -> bool:
        """Return whether the lines of a start, pulled within search_px, come to lie on those of a known pose."""
        return any(self._leads(start, *known, search_px) for known in self._known)

    def _leads(self, start: Rigid, pose: Rigid, sights: Sequence[Sight], search_px: float) -> bool:
        end = attracted(sights, start, self._freedom, search_px=search_px)
        return max(s.moved_px(end, pose) for s in sights) < _SAME_PX
