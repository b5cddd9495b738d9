"""Stretches of lines along which visibility cannot change, and runs of equal ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.render.lines.clip import FlatSegments

_NEGLIGIBLE = 1e-7  # of u: cuts closer together than this (1e-4 px for a focal length of 1000 px) are one
_END = 1e-8  # of a line: cuts closer to its ends are ignored


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Fractions [s0, s1] of the images of lines (N,), in order along each line and line after line."""

    line: Longs
    s0: Array
    s1: Array

    @classmethod
    def between(cls, line: Longs, s: Array, lines: FlatSegments) -> Stretches:
        """Return the stretches between the cuts (line, s) of all lines."""
        every = np.arange(len(lines))
        inner = (s > _END) & (s < 1 - _END)
        cuts = 2.0 * line[inner] + s[inner]  # line and fraction in one number: one fast sort
        keys = np.sort(np.concatenate([2.0 * every, 2.0 * every + 1, cuts]))
        line = (keys / 2).astype(np.int64)
        s = keys - 2 * line
        fine = (_NEGLIGIBLE / np.maximum(np.linalg.norm(lines.b - lines.a, axis=1), _NEGLIGIBLE))[line]
        kept = (s == 0) | (s == 1) | ((np.diff(s, prepend=-1.0) > fine) & (1 - s > fine))
        line, s = line[kept], s[kept]
        same = line[1:] == line[:-1]
        return cls(line[:-1][same], s[:-1][same], s[1:][same])

    def middle(self, lines: FlatSegments) -> Array:
        """Return t in space, on the unclipped line, of the middle of each stretch's image."""
        return lines.in_space(self.line, (self.s0 + self.s1) / 2)

    def merged(self, hidden: Mask, wanted: bool) -> Stretches:
        """Return the longest runs of stretches whose `hidden` (N,) is as wanted."""
        if not len(self.line):
            return self
        begins = np.append(True, (self.line[1:] != self.line[:-1]) | (hidden[1:] != hidden[:-1]))
        ends = np.append(begins[1:], True)
        chosen = hidden[begins] == wanted
        return Stretches(self.line[begins][chosen], self.s0[begins][chosen], self.s1[ends][chosen])
