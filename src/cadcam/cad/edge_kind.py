"""The kinds of feature edges."""

from __future__ import annotations

from enum import IntEnum


class EdgeKind(IntEnum):
    """The reason why an edge is drawn: fold, end, contact of two parts, B-rep edge, or (per view) silhouette."""

    CREASE = 0
    BOUNDARY = 1
    CONTACT = 2
    BREP = 3
    CONTOUR = 4
