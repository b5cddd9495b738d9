"""Crossings of segments in the image plane: exact, without sampling; found with a grid in the C core."""

from __future__ import annotations

from cadcam.arrays import Array, Longs
from cadcam.native import crossing
from cadcam.render.lines.clip import FlatSegments


def crossings(lines: FlatSegments, borders: FlatSegments, *, slack: Array) -> tuple[Longs, Array]:
    """Return (line index, fraction s of its image) of every crossing with a border that is not behind the line there.

    `slack` (M,) lengthens each border at both ends by that distance in u, so that a line through the common end of two
    borders is cut by at least one of them. Parallel segments do not cross. A crossing may be listed more than once.
    Raises `MissingCore` where cadcam was installed without its C core.
    """
    one, other = ((s.a, s.b, s.wa, s.wb) for s in (lines, borders))
    return crossing.crossings(one, other, slack)
