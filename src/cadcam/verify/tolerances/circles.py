"""The circles of a hole, a pin or the end of a pipe, about one axis, found in the CAD's own edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.geometry.plane import axes_across

# Of the radius, by which points may be off a circle: coordinates of files in single precision are off by less.
_ROUND = 1e-3
_SIDES = 8  # of a full turn: fewest that are a circle, and no nut
_AXIS_DEG = 0.5  # between axes that are one


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Circles(Brief):
    """Circles about one axis through `centre` (3,) mm along the unit vector `axis` (3,), of `radii` (c,) mm, ascending.

    sagitta (c,) mm: by how much the middle of the CAD's longest chord lies within each.
    """

    centre: Array
    axis: Array
    radii: Array
    sagitta: Array

    @classmethod
    def through(cls, lines: Sequence[Array]) -> Circles | None:
        """Return the circles that polylines (n, 3) mm run on; None where one does not, or another axis has its own."""
        axes = [_axis_of(line) for line in lines]
        if not axes or any(axis is None for axis in axes):
            return None
        every = np.array(axes)
        if (np.abs(every @ every[0]) < np.cos(np.radians(_AXIS_DEG))).any():
            return None
        axis = (every * np.sign(every @ every[0])[:, None]).mean(axis=0)
        axis /= np.linalg.norm(axis)
        flat = [line @ np.stack(axes_across(axis), axis=1) for line in lines]
        centre = _common_centre(flat)
        apart = [np.linalg.norm(line - centre, axis=1) for line in flat]
        radii = np.array([r.mean() for r in apart])
        if any((np.abs(r - mean) > _ROUND * mean).any() for r, mean in zip(apart, radii, strict=True)):
            return None
        chord = np.array([np.linalg.norm(np.diff(line, axis=0), axis=1).max() for line in flat])
        if (chord > 2 * radii * np.sin(np.pi / _SIDES) * (1 + _ROUND)).any():
            return None
        order = np.argsort(radii)
        return cls(np.stack(axes_across(axis), axis=1) @ centre, axis, radii[order], (chord**2 / (8 * radii))[order])

    def outward(self, p: Array) -> Array:
        """Return the unit vectors (N, 3) from the axis to places (N, 3) mm."""
        d = self._from_axis(p)
        return np.asarray(d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-300))

    def inside(self, p: Array) -> Array:
        """Return by how much (N,) mm places (N, 3) mm on chords lie within their circles; 0 for what is on none."""
        off = self.radii - np.linalg.norm(self._from_axis(p), axis=1)[:, None]
        near = np.abs(off).argmin(axis=1)
        inside = off[np.arange(len(off)), near]
        return np.asarray(np.where(np.abs(inside) < self.sagitta[near] + _ROUND * self.radii[near], inside, 0.0))

    def _from_axis(self, p: Array) -> Array:
        d = p - self.centre
        return np.asarray(d - np.outer(d @ self.axis, self.axis))


def _axis_of(line: Array) -> Array | None:
    """Return the unit normal (3,) of the plane that a bent polyline (n, 3) lies in; None for one in no plane."""
    if len(line) < 3:
        return None
    _, S, Vt = np.linalg.svd(line - line.mean(axis=0), full_matrices=False)
    if S[1] <= _ROUND * S[0] or S[2] > _ROUND * S[1]:
        return None
    return np.asarray(Vt[2])


def _common_centre(flat: Sequence[Array]) -> Array:
    """Return the centre (2,) of circles of own radii through points (n, 2) each: |x|^2 = 2 c . x + (r^2 - |c|^2)."""
    middle = np.concatenate(flat).mean(axis=0)
    x, number = np.concatenate(flat) - middle, np.repeat(np.arange(len(flat)), [len(line) for line in flat])
    A = np.column_stack([2 * x, np.eye(len(flat))[number]])
    return np.asarray(middle + np.linalg.lstsq(A, (x**2).sum(axis=1), rcond=None)[0][:2])
