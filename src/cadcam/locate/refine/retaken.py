"""Poor photos, looked at once more where nothing is found in them: smoothed, or as a coarser camera had taken them.

A photo may have more pixels than its lens, its demosaicing or an enlargement has detail. A step then spreads over
several pixels, and so does grain, which no longer looks like noise: lines are there, but not as close and as steady, in
px, as in other photos. Reduced by what the blur allows it shows the same, and is as any other. But what counts as close
is some tenths of a pixel up to two (`locate.quality.shown`), which is much of a small part: so parts stay large.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import Longs
from cadcam.image.profile import blur_of
from cadcam.locate.location import Location
from cadcam.locate.photo import Photo
from cadcam.locate.refine.answer import CLEARLY

_SHARP_PX = 0.55  # blur of a sharp lens, with the pixel's own area
_LARGE_PX = 300.0  # size of the part in view down to which a photo is reduced; at half of that other models fit, too
_REACH_PX, _HALF_PX = 9.0, 2.0  # cells in which the blur is estimated, across the lines and along them

# What is found in photos, each reduced so many times: the surest first; one that is not found, if nothing is.
Look = Callable[[Sequence[Photo], Sequence[int]], list[Location]]


def in_spite_of_noise(photos: Sequence[Photo], times: Sequence[int], found_in: Look) -> list[Location]:
    """Return what is found in the photos; if nothing is, and noise hides lines, what is found in smoothed ones.

    times: by how many times each of them is reduced.
    """
    first = found_in(photos, times)
    if first[0].found:
        return first
    calm = [photo.calmed() for photo in photos]
    return first if all(photo.calm is None for photo in calm) else _better(first, found_in(calm, times))


def at_their_sharpness(photos: Sequence[Photo], found_in: Look) -> list[Location]:
    """Return what is found in spite of noise; if nothing is, and photos are blurred, what is found in reduced ones.

    How much they are blurred is asked of the lines that the answer believed. Its pixels are always those of the photos.
    """
    first = in_spite_of_noise(photos, [1] * len(photos), found_in)
    if first[0].found:
        return first
    times = [_reduction(photo, first[0], k) for k, photo in enumerate(photos)]
    if max(times) == 1:
        return first
    reduced = [photo.reduced(by) for photo, by in zip(photos, times, strict=True)]
    second = in_spite_of_noise(reduced, times, found_in)
    return _better(first, [_in_pixels_of_photos(one, np.array(times)) for one in second])


def _better(first: list[Location], second: list[Location]) -> list[Location]:
    return second if second[0].found or second[0].quality > first[0].quality + CLEARLY else first


def _reduction(photo: Photo, location: Location, number: int) -> int:
    """Return by how many times a photo may be made smaller without losing what it shows along the part's lines."""
    m = location.matches
    here = m.photo == number
    seen = here & m.believed
    if not seen.any():
        return 1
    most = int(np.hypot(*np.ptp(m.q[here], axis=0)) / _LARGE_PX)
    if most < 2:
        return 1
    q = m.q[seen] + m.offset[seen, None] * m.normal[seen]
    blur = blur_of(photo.gray, q, m.normal[seen], reach=np.full(len(q), _REACH_PX), half_length=_HALF_PX)
    return max(1, min(round(blur / _SHARP_PX), most))


def _in_pixels_of_photos(location: Location, times: Longs) -> Location:
    """Return an answer from photos reduced so many times (photos,), with its pixels those of the photos."""
    m = location.matches
    by = times[m.photo].astype(float)
    matches = replace(m, q=by[:, None] * m.q + (by[:, None] - 1) / 2, offset=by * m.offset, sigma=by * m.sigma)
    disagreements = tuple(replace(one, px=float(times[one.photo]) * one.px) for one in location.disagreements)
    return replace(
        location,
        matches=matches,
        disagreements=disagreements,
        off_px=float(np.median(times)) * location.off_px,
        alternatives=tuple(_in_pixels_of_photos(one, times) for one in location.alternatives),
        why=location.why.noting(f"in photos reduced {max(times)} times, px are of these: they are blurred"),
    )
