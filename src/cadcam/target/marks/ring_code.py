"""The ring of a mark read once its ellipse is known: its direction, or the number of a coded mark."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.target.marks.mark import FULL, Mark, ring_numbers

_SAMPLES, _BIT = 240, 16  # around a ring, and per bit
_CLEAR = 0.15  # of the ring's contrast: bits closer to the threshold are doubtful


def oriented(gray: Picture, mark: Mark, q: Array, shapes: Array) -> Array:
    """Return shapes (B, 2, 2) px per mm, rotated so that the mark's sectors lie where they are seen."""
    angles = np.arange(_SAMPLES) * (FULL / _SAMPLES)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    dark = np.array([mark.inked(radius * circle) != mark.light for radius in _radii(mark)], np.float64)
    seen = np.concatenate([_ring(gray, q, shapes, radius * circle) for radius in _radii(mark)], axis=1)
    score = np.stack([_agreement(seen, dark, k) for k in range(_SAMPLES)], axis=1)
    return _turned(shapes, np.asarray(score.argmax(axis=1) * (FULL / _SAMPLES), np.float64))


def read(gray: Picture, like: Mark, q: Array, shapes: Array) -> tuple[list[int | None], Array]:
    """Return the numbers of coded marks of the same family, None where unreadable, and their rotated shapes."""
    bits = code_bits(like)
    angles = (np.arange(bits * _BIT) + 0.5) * (FULL / (bits * _BIT))
    circle = float(np.mean(_radii(like))) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    ring = _ring(gray, q, shapes, circle)
    valid = set(ring_numbers(bits))
    numbers: list[int | None] = []
    turn = np.zeros(len(q))
    for i, values in enumerate(ring):
        number, turn[i] = _number(values if like.light else -values, bits)
        numbers.append(number if number in valid else None)
    return numbers, _turned(shapes, turn)


def code_bits(mark: Mark) -> int:
    """Return the number of bits in a coded mark's ring."""
    last = mark.name.split(":")[-1]
    return int(last) if last.isdecimal() else 12


def _number(values: Array, bits: int) -> tuple[int | None, float]:
    """Return the number in values around a ring, high for set bits, and the angle at which its first bit starts."""
    each = len(values) // bits
    middle = (np.percentile(values, 90) + np.percentile(values, 10)) / 2
    swing = np.ptp(np.percentile(values, [10, 90]))
    if swing <= 0:
        return None, 0.0
    shifted = [np.roll(values, -k).reshape(bits, each).mean(axis=1) - middle for k in range(each)]
    k = int(np.argmax([np.abs(s).sum() for s in shifted]))
    if np.abs(shifted[k]).min() < _CLEAR * swing:
        return None, 0.0
    on = shifted[k] > 0
    turned = [int(sum(1 << j for j in range(bits) if on[(j + first) % bits])) for first in range(bits)]
    first = int(np.argmin(turned))
    return turned[first], (first * each + k) * (FULL / len(values))


def _radii(mark: Mark) -> list[float]:
    """Return the mean radii of the rings that have sectors, mm."""
    rings = np.unique(mark.sectors[~mark.full, :2], axis=0)
    return [float(np.mean(r)) for r in rings]


def _ring(gray: Picture, q: Array, shapes: Array, circle: Array) -> Array:
    """Return the grey values (B, S) at points (S, 2) mm of the marks."""
    from scipy.ndimage import map_coordinates

    at = q[:, None] + circle @ np.swapaxes(shapes, 1, 2)
    return np.asarray(map_coordinates(gray, [at[..., 1], at[..., 0]], order=1, mode="nearest"), np.float64)


def _agreement(seen: Array, dark: Array, by: int) -> Array:
    """Return the likeness of rings (B, R S) to those of a mark (R, S), 1 where it is dark, rotated by some samples."""
    turned = np.roll(dark, by, axis=1).ravel()
    return np.asarray(-(seen @ (turned - turned.mean())))


def _turned(shapes: Array, angle: Array) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(shapes @ np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2))
