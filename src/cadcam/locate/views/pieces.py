"""The visible lines of one view as straight pieces, and samples spread along them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.fit.optimal_design import design
from cadcam.geometry.rigid import Rigid
from cadcam.native.fields import PLACE

PLACES = 320  # samples of the visible edges of one view
GOLDEN = (math.sqrt(5) - 1) / 2  # the fractional parts of its first n multiples are spread evenly, whatever n is
_RANK = np.argsort(np.argsort(np.modf(np.arange(PLACES) * GOLDEN)[0]))  # any first n are spread evenly


class ShownEdges(NamedTuple):
    """The edges visible in one view: places, line, telling (N,) as in `Aspect`, and the total length in px."""

    places: npt.NDArray[np.void]
    line: Ids
    telling: npt.NDArray[np.void]
    length: float


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Straight pieces: ends a, b (N, 3) mm in the part frame, length (N,) px, and the line (N,) that each is of.

    The pieces of a line are consecutive.
    """

    a: Array
    b: Array
    length: Array
    line: Longs

    @classmethod
    def between(cls, q: Array, p: Array, first: Longs, line: Longs) -> Pieces:
        """Return the pieces that lead from some (N,) of the points q (n, 2) px, p (n, 3) mm, to the next ones."""
        d = q[first + 1] - q[first]
        return cls(p[first], p[first + 1], np.hypot(d[:, 0], d[:, 1]), line)

    def shown(self, camera_from_part: Rigid, centre: Array, radius: float) -> ShownEdges:
        """Return samples of the pieces in their view; centre (3,), radius: of what is located, mm."""
        if not len(self.line):
            none = np.zeros(0, PLACE)
            return ShownEdges(none, np.zeros(0, np.int32), none, 0.0)
        depth = camera_from_part.matrix[2]
        places, k = self._sampled(self.length, depth)
        telling, _ = self._sampled(self._design(camera_from_part.origin, centre, radius), depth)
        numbers = np.unique(self.line[k], return_inverse=True)[1].ravel().astype(np.int32)
        return ShownEdges(places, numbers, telling, float(self.length.sum()))

    def _design(self, eye: Array, centre: Array, radius: float) -> Array:
        """Return the share (N,) of samples that each piece gets, by length and by what it tells of the pose.

        Nearly all of a long bar's lines run along it, and are the same wherever it is shifted to: only its ends, a
        fiftieth of them, tell where it is.
        """
        middle = (self.a + self.b) / 2
        normal = np.cross(self.b - self.a, middle - eye)  # of the plane that a piece is seen in
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) * np.linalg.norm(middle - eye, axis=1, keepdims=True)
        rows = np.concatenate([normal, np.cross((middle - centre) / radius, normal)], axis=1)
        return design(np.nan_to_num(rows), self.length)

    def _sampled(self, share: Array, depth: Array) -> tuple[npt.NDArray[np.void], Longs]:
        """Return samples (PLACES,) of the pieces, each piece's in proportion to a share (N,), and the piece of each.

        depth (4,): third row of camera_from_part.
        """
        ends = np.concatenate([[0.0], np.cumsum(share)])
        along = (_RANK + 0.5) / PLACES * ends[-1]
        k = np.clip(np.searchsorted(ends, along, side="right") - 1, 0, len(share) - 1)
        part = np.clip((along - ends[k]) / share[k], 0, 1)
        a, b = self.a[k], self.b[k]
        za, zb = a @ depth[:3] + depth[3], b @ depth[:3] + depth[3]
        places = np.zeros(PLACES, PLACE)
        places["p"] = a + (part * za / (part * za + (1 - part) * zb))[:, None] * (b - a)
        places["tangent"] = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1), 1e-300)[:, None]
        places["weight"] = 1.0
        return places, k

    def select(self, which: Longs | slice) -> Pieces:
        """Return the chosen ones."""
        return Pieces(*(getattr(self, f.name)[which] for f in fields(self)))


def leads_on(start: Ids, points: int) -> Mask:
    """Return which points of polylines, so many in all, that start at these lead to a next one: all but the last ones.

    start (lines + 1,): the last one is the number of points.
    """
    leads = np.ones(points, bool)
    leads[start[1:] - 1] = False
    return leads
