"""Where the photos show edges near places on the model's lines: several candidates each, with what the noise allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.locate.photo import Photo
from cadcam.verify.sightlines import Sightlines

_STEP = 0.5
_SMOOTH = 1.0
_ACROSS = 4
_MOST = 8
_SIGNIFICANT = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Edges found near N places: offset (N, K) px along the normal, nan where there are fewer; sigma (N, K) px by the
    photo's noise; step (N, K) grey value, signed: how much brighter it gets along the normal."""

    offset: Array
    sigma: Array
    step: Array


def candidates(photos: Sequence[Photo], lines: Sightlines, *, reach_px: float) -> Candidates:
    """Return all significant edges within `reach_px` of the places."""
    n = len(lines)
    out = [np.full((n, _MOST), np.nan) for _ in range(3)]
    for i, photo in enumerate(photos):
        mine = np.flatnonzero(lines.photo == i)
        for a, b in zip(out, _in_photo(photo.gray, lines.q[mine], lines.normal[mine], reach_px), strict=True):
            a[mine] = b
    return Candidates(*out)


def _in_photo(gray: Picture, q: Array, normal: Array, reach: float) -> tuple[Array, Array, Array]:
    from scipy.ndimage import gaussian_filter1d, map_coordinates

    noise = noise_of(gray)
    t = np.arange(-reach - 3, reach + 3 + _STEP / 2, _STEP)
    u = np.arange(_ACROSS) - (_ACROSS - 1) / 2
    tangent = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
    at = q[:, None, None] + t[:, None, None] * normal[:, None, None] + u[:, None] * tangent[:, None, None]
    profile = map_coordinates(gray, [at[..., 1], at[..., 0]], order=1, mode="nearest").mean(axis=-1).astype(np.float64)
    width = _SMOOTH / _STEP
    d = gaussian_filter1d(profile, width, axis=1, order=1) / _STEP
    sd = noise / np.sqrt(_ACROSS) / np.sqrt(4 * np.sqrt(np.pi) * _SMOOTH**3)
    m = np.abs(d)
    peak = np.zeros(m.shape, bool)
    peak[:, 1:-1] = (m[:, 1:-1] > m[:, :-2]) & (m[:, 1:-1] >= m[:, 2:]) & (m[:, 1:-1] > _SIGNIFICANT * sd)
    peak[:, np.abs(t) > reach] = False
    row, col = np.nonzero(peak)
    lo, mid, hi = np.log(np.maximum(np.stack([m[row, col - 1], m[row, col], m[row, col + 1]]), 1e-9))
    shift = np.clip(0.5 * (lo - hi) / np.minimum(lo - 2 * mid + hi, -1e-9), -1, 1)
    rank = np.arange(len(row)) - np.searchsorted(row, row)
    keep = rank < _MOST
    row, col, rank, shift = row[keep], col[keep], rank[keep], shift[keep]
    outs = [np.full((len(q), _MOST), np.nan) for _ in range(3)]
    outs[0][row, rank] = t[col] + shift * _STEP
    blur = 0.7
    c = d[row, col] * np.sqrt(2 * np.pi) * np.hypot(blur, _SMOOTH)
    outs[1][row, rank] = 1.6 * np.sqrt(2 * np.sqrt(np.pi) * np.hypot(blur, _SMOOTH) * noise**2 / (c**2 * _ACROSS))
    outs[2][row, rank] = c
    return outs[0], outs[1], outs[2]


def noise_of(gray: Picture) -> float:
    """Return the standard deviation of a pixel's noise (J. Immerkaer, Fast noise variance estimation, CVIU 64, 1996)."""
    from scipy.ndimage import convolve

    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    return max(float(np.median(np.abs(convolve(gray, mask)))) / 0.6745 / 6.0, 1e-4)
