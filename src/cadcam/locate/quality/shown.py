"""Which of a part's lines the photo shows where they are drawn, and how many it would show anywhere.

A sample counts as shown where brightness steps very near it, about as strongly as anywhere around, and where the next
sample on the line finds a step at the same distance and of the same sign: a line, not a speckle. The same test on lines
shifted to where the part is not gives the level of chance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array, Ids, Mask
from cadcam.image.profile import slope_noise
from cadcam.locate.lines.sight import Sight, in_noise

_OTHERS_PX = 1.0  # part of the room between two lines that belongs to the other one
ROOM_PX = 2.5 + _OTHERS_PX  # with less room to another line a sample cannot be judged
_NEAR_PX, _SCATTERS = (0.8, 2.0), 4.0  # distance between a line and its step: px, and multiples of the scatter of edges
_REACH = 6  # px: range around a line within which its step is compared with others
_AGREE_PX = 0.5  # largest difference between neighbours on a line
_FAINT = 0.4  # least slope, relative to the strongest nearby
# Where noise hides lines: px along a line, to each side, over which steps are averaged; significance of steps, sd.
_IN_NOISE = 4.0, 3.0
_WIDE, _SURELY, _MOST_SHIFTED = 1.0, 1.5, 1.2  # px, blur of a step there; sd, and most px, by which noise may shift it
_FAR, _AT = np.array([0.0, 14.0, 22.0, 14.0, 22.0]), np.array([0.0, 0.3, 1.9, 3.4, 5.0])  # px, rad
_SHIFTS = _FAR[:, None] * np.stack([np.cos(_AT), np.sin(_AT)], axis=1)  # px: in place, then elsewhere


def near_px(sights: Sequence[Sight], scatter: float) -> float:
    """Return the largest distance (px) between a line and its step, given the scatter (px) of edges.

    In smoothed photos no allowance is made for scatter: there it is due to noise, not to a different model.
    """
    return _NEAR_PX[0] if in_noise(sights) else float(np.clip(_SCATTERS * scatter, *_NEAR_PX))


def shown(sight: Sight, q: Array, normal: Array, run: Ids, room: Array, near: Array) -> tuple[Mask, Array]:
    """Return which samples (n,) show an edge, and the share that does in place and after each shift.

    q, normal (n, 2), run (n,): their places and lines; room (n,) px: to the next line. near (n,) px: largest distance
    to their step (`near_px`). Samples without any step nearby count half.
    """
    room = np.minimum(room - _OTHERS_PX, _REACH)
    places = (q + _SHIFTS[:, None]).reshape(-1, 2)
    normals = np.tile(normal, (len(_SHIFTS), 1))
    half_length, clear = (2.0, 4.0) if sight.photo.calm is None else _IN_NOISE
    found = sight.candidates(places, normals, half_length=half_length, reach=_REACH, clear=clear)
    sd = _sd_place(sight, found.slope, half_length)
    offset = np.abs(found.offset).reshape(len(_SHIFTS), len(q), -1)
    slope = np.where(offset <= room[:, None], np.abs(found.slope).reshape(offset.shape), 0.0)
    strongest = slope.max(axis=2)
    within = np.sqrt(near[:, None] ** 2 + sd.reshape(offset.shape) ** 2)
    close = (offset < within) & (slope > _FAINT * strongest[:, :, None])
    best = np.argmax(np.where(close, slope, 0.0), axis=2).ravel() + np.arange(len(places)) * offset.shape[2]
    at, sign, sd = found.offset.ravel()[best], np.sign(found.slope.ravel()[best]), sd.ravel()[best]
    good, at, sign, sd = (a.reshape(len(_SHIFTS), -1) for a in (close.ravel()[best], at, sign, sd))
    here = _continued(good, at, sign, run, sd)
    return here[0], 2 * here.sum(axis=1) / ((strongest > 0).sum(axis=1) + len(q))


def _sd_place(sight: Sight, slope: Array, half_length: float) -> Array:
    """Return the sd (N, M) px by which noise may shift steps of these slopes; 0 unless noise hides lines.

    A step of slope a, smoothed to a width s by a filter of width f, has curvature a / s^2 at its top; noise n of the
    slope changes the curvature by sqrt(3/2) n / f.
    """
    if sight.photo.calm is None:
        return np.zeros(slope.shape)
    filter2 = 1 + sight.photo.spread**2
    shift = slope_noise(sight.noise, half_length, sight.photo.spread) * np.sqrt(1.5 / filter2) * (filter2 + _WIDE**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.minimum(_SURELY * shift / np.abs(slope), _MOST_SHIFTED))


def _continued(good: Mask, offset: Array, sign: Array, run: Ids, sd: Array) -> Mask:
    """Return which good samples (..., n) have a good neighbour on their run, of the same sign and distance.

    sd (..., n) px: their uncertainty by noise.
    """
    same = (run[1:] == run[:-1]) & (sign[..., 1:] == sign[..., :-1])
    apart = np.sqrt(_AGREE_PX**2 + sd[..., 1:] ** 2 + sd[..., :-1] ** 2)
    pair = good[..., 1:] & good[..., :-1] & same & (np.abs(np.diff(offset)) < apart)
    out = np.zeros(good.shape, bool)
    out[..., 1:] |= pair
    out[..., :-1] |= pair
    return out
