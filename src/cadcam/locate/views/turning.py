"""By which angles the edges of a part may be turned about an axis so that many lie on edges again, as a ring of holes.

Edges are points in cylindrical coordinates: distance from the axis, height, angle. Turning shifts the angles alone, so
the share of points that meet others after every turn at once is a circular correlation, ring by ring. How far to shift
along the axis is asked first, of the rings as a whole: that bounds what any turn can do.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cadcam.arrays import Array, Ids, Mask

_CELL = 0.03  # size of a ring, across and in height, by the radius of the part
_ANGLES = 720  # tried in a full turn
_BESIDE = 12  # such angles to both sides of a turn that must do worse: 6 degrees
_ABOVE = 0.03  # by which share of all points, at the least
_SHIFTS = 2  # along the axis


def turns_onto(points: Array, others: Array, radius: float, least: float) -> Iterator[tuple[float, float]]:
    """Yield angles (rad) about z, and shifts along it, that lay this share of points (n, 3) or more on others (m, 3).

    Only angles that do better than those beside them: of a turned part, which any angle turns onto itself, none. Cells
    are by the radius of the part; points nearer to the axis than one lie at any angle.
    """
    p, q = _Rings(points, _CELL * radius), _Rings(others, _CELL * radius)
    for up in p.shifts_onto(q, least):
        share = p.shares_on(q, up)
        around = np.stack([np.roll(share, k) for k in range(-_BESIDE, _BESIDE + 1)])
        peak = (share >= around.max(axis=0)) & (share >= least) & (share > around.min(axis=0) + _ABOVE)
        for angle in np.flatnonzero(peak & ~np.roll(peak, 1)):  # of several in a row the first
            yield float(angle) * 2 * np.pi / _ANGLES, float(up - p.low + q.low) * _CELL * radius


class _Rings:
    """Points (n, 3) by the numbers of their distance from the axis, height and angle; low: the lowest height's."""

    def __init__(self, points: Array, cell: float) -> None:
        x, y, z = points.T
        self.far, high = (np.floor(v / cell + 0.5).astype(np.int32) for v in (np.hypot(x, y), z))
        self.low = int(high.min())
        self.high: Ids = high - self.low
        self.at: Ids = np.floor(np.arctan2(y, x) / (2 * np.pi) * _ANGLES).astype(np.int32) % _ANGLES

    def shifts_onto(self, other: _Rings, least: float) -> list[int]:
        """Return by how many cells to shift these up so that most rings meet some of the other, best first."""
        tall = int(self.high.max() + other.high.max()) + 1
        near = np.zeros((int(max(self.far.max(), other.far.max())) + 2, 2 * tall + 2), bool)
        near[other.far, other.high + tall] = True
        near = _widened(_widened(near, 0), 1)
        by = np.arange(-int(self.high.max()), int(other.high.max()) + 1)
        share = np.array([near[self.far, self.high + k + tall].mean() for k in by])
        out: list[int] = []
        while len(out) < _SHIFTS and share.max() >= least:
            best = int(np.argmax(share))
            level = np.flatnonzero(share == share[best])  # of several that are as good the middle one
            best = int(level[len(level) // 2]) if np.ptp(level) < len(level) else best
            out.append(int(by[best]))
            share[max(best - 2, 0) : best + 3] = 0
        return out

    def shares_on(self, other: _Rings, up: int) -> Array:
        """Return the share (`_ANGLES`,) of these points that lie near others once shifted up, after each turn."""
        tall = int(max(self.high.max() + abs(up), other.high.max() + abs(up))) + 3
        shape = int(max(self.far.max(), other.far.max())) + 2, tall + abs(up), _ANGLES
        near, here = np.zeros(shape, bool), np.zeros(shape, np.float32)
        near[other.far, other.high + 1 + max(-up, 0), other.at] = True
        for axis in range(3):  # nearer than a cell, or half a degree
            near = _widened(near, axis)
        near[0] |= near[0].any(axis=1, keepdims=True)
        np.add.at(here, (self.far, self.high + 1 + max(up, 0), self.at), 1.0)
        both = near.any(axis=2) & here.any(axis=2)
        spectrum = np.conj(np.fft.rfft(here[both])) * np.fft.rfft(near[both])
        return np.asarray(np.fft.irfft(spectrum.sum(axis=0), _ANGLES) / len(self.at))


def _widened(near: Mask, axis: int) -> Mask:
    """Return cells with those beside them along an axis."""
    return np.asarray(near | np.roll(near, 1, axis) | np.roll(near, -1, axis))
