"""Visibility in a rendered view by the C core (seen.h), as functions of arrays."""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.native.core import addresses, functions

ALWAYS, FACING, TURNING = 0, 1, 2  # CC_ALWAYS ...: when an edge is drawn


class _DepthView(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("depth", "normal")),
        *((name, c.c_float) for name in ("px", "py", "slack", "steepest")),
        *((name, c.c_int32) for name in ("width", "height")),
    )


class _EyePoint(c.Structure):
    _fields_ = (("pose", c.c_double * 12), ("K", c.c_double * 6), ("near", c.c_double))


class _Edges(c.Structure):
    _fields_ = (*((name, c.c_void_p) for name in ("ends", "sides", "chain", "rule")), ("n", c.c_int64))


class _Lines(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("q", "p", "edge", "start")),
        *((name, c.c_int64) for name in ("room", "points", "lines")),
    )


@cache
def _core() -> c.CDLL:
    view, pointer, real = c.POINTER(_DepthView), c.c_void_p, c.c_double
    of_edges = [c.POINTER(_EyePoint), c.POINTER(_Edges), pointer, real, real, real, c.POINTER(_Lines)]
    return functions(
        "the removal of hidden lines",
        {
            "cc_seen": (None, [view, c.c_int64, pointer, pointer, pointer]),
            "cc_seen_edges": (None, [view, *of_edges]),
        },
    )


class DepthView:
    """What a view of depth (H, W) mm and unit normals (H, W, 3) hides; see seen.h.

    pixel: its width and height in the plane (x, y)/z.
    """

    def __init__(
        self, depth: Picture, normal: Picture, pixel: tuple[float, float], *, slack: float, steepest: float
    ) -> None:
        self._kept = np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(normal, np.float32)
        height, width = depth.shape
        self.request: c.Structure = _DepthView(*addresses(*self._kept), *pixel, slack, steepest, width, height)

    def points(self, p: Array, q: Array) -> Mask:
        """Return which points (n,) are visible: p (n, 3) mm in the camera frame, q (n, 2) px."""
        p, q = np.ascontiguousarray(p, np.float64), np.ascontiguousarray(q, np.float64)
        out = np.zeros(len(p), bool)
        _core().cc_seen(c.byref(self.request), len(p), *addresses(p, q, out))
        return out


@dataclass(frozen=True, slots=True, eq=False)
class EyePoint:
    """A camera without distortion: camera_from_world (3, 4), K (2, 3), and the least visible depth, mm."""

    pose: Array
    K: Array
    near: float


@dataclass(frozen=True, slots=True, eq=False)
class SeenLines:
    """Polylines: q (N, 2) px, p (N, 3) mm, the edge (N,) that leads away from each point, start (M + 1,)."""

    q: Array
    p: Array
    edge: Ids
    start: Ids


class EdgesInSpace:
    """Straight edges, kept for many views: ends (n, 2, 3) mm, sides (n, 2), chain (n,), rule (n,): ALWAYS, ..."""

    def __init__(self, ends: Array, sides: Ids, chain: Ids, rule: npt.NDArray[np.uint8]) -> None:
        kinds = (np.float64, np.int32, np.int32, np.uint8)
        given = (ends, sides, chain, rule)
        self._kept = [np.ascontiguousarray(a, kind) for a, kind in zip(given, kinds, strict=True)]
        self._edges = _Edges(*addresses(*self._kept), len(chain))
        self._room = 1024  # points; enlarged once a view has more

    def seen(
        self, view: DepthView, eye: EyePoint, front: Mask, *, step: float, shortest: float, bend: float
    ) -> SeenLines:
        """Return the visible stretches in a view; front: the planes whose front the camera sees; see seen.h."""
        while True:
            room = self._room
            out, points, lines = self._written(view, eye, front, room, (step, shortest, bend))
            if points <= room >= lines:
                start = np.append(out.start[:lines], np.int32(points))
                return SeenLines(out.q[:points], out.p[:points], out.edge[:points], start)
            self._room = 2 * max(points, lines)

    def _written(
        self, view: DepthView, eye: EyePoint, front: Mask, room: int, lengths: tuple[float, float, float]
    ) -> tuple[SeenLines, int, int]:
        """Return as much as there is room for, and the total numbers of points and lines."""
        out = SeenLines(np.zeros((room, 2)), np.zeros((room, 3)), *np.zeros((2, room), np.int32))
        told = _Lines(*addresses(out.q, out.p, out.edge, out.start), room)
        place = _EyePoint((c.c_double * 12)(*eye.pose.ravel()), (c.c_double * 6)(*eye.K.ravel()), eye.near)
        front = np.ascontiguousarray(front, bool)
        given = (c.byref(view.request), c.byref(place), c.byref(self._edges), front.ctypes.data)
        _core().cc_seen_edges(*given, *lengths, c.byref(told))
        return out, told.points, told.lines
