"""What makes an edge a line."""

from __future__ import annotations

from enum import IntEnum


class EdgeKind(IntEnum):
    """What makes an edge a line: a fold, an end, two parts meeting, a B-rep edge, or (per view) a silhouette."""

    CREASE = 0
    BOUNDARY = 1
    CONTACT = 2
    BREP = 3
    CONTOUR = 4
