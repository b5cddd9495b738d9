"""Stretches of lines along which visibility cannot change, and runs of equal ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.render.clip import FlatSegments
from cadcam.render.occlusion import Longs

_NEGLIGIBLE = 1e-7  # of u: cuts closer together than this (1e-4 px for a focal length of 1000 px) are one


@dataclass(frozen=True, slots=True, eq=False)
class Stretches:
    """Fractions [s0, s1] of the images of lines (N,), in order along each line and line after line."""

    line: Longs
    s0: Array
    s1: Array

    @classmethod
    def between(cls, line: Longs, s: Array, lines: FlatSegments) -> Stretches:
        """Return what the cuts (line, s) leave of all lines."""
        every = np.arange(len(lines))
        line, s = np.concatenate([every, line, every]), np.concatenate([np.zeros(len(lines)), s, np.ones(len(lines))])
        order = np.lexsort((s, line))
        line, s = line[order], s[order]
        length = np.linalg.norm(lines.b - lines.a, axis=1)[line]
        first = np.append(True, line[1:] != line[:-1])
        last = np.append(first[1:], True)
        gap = np.append(np.inf, np.diff(s)) * length
        end_gap = (1 - s) * length
        kept = first | last | ((gap > _NEGLIGIBLE) & (end_gap > _NEGLIGIBLE))
        line, s = line[kept], s[kept]
        same = line[1:] == line[:-1]
        return cls(line[:-1][same], s[:-1][same], s[1:][same])

    @classmethod
    def none(cls) -> Stretches:
        """Return no stretches."""
        return cls(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))

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
