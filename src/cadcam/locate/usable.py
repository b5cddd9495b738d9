"""Whether photos can show a part at all: with contrast, exposed so that edges show, each of them once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cadcam.arrays import quantile
from cadcam.errors import UnusablePhoto
from cadcam.locate.photo import Photo

_LOOKED_AT = 5_000  # pixels of a photo that are sampled to check its exposure
_FLAT, _CLIPPED = 2.0 / 255.0, 0.98  # least contrast of a photo; largest share of black or white pixels


def check_photos(photos: Sequence[Photo]) -> None:
    """Raise `UnusablePhoto` for no photo, one twice, and one without contrast or of black and white pixels."""
    if not photos:
        raise UnusablePhoto("photos", "none", "at least one photo")
    for photo in photos:
        check_exposure(photo)
    for k, photo in enumerate(photos):
        again = next((one for one in photos[:k] if np.array_equal(one.gray, photo.gray)), None)
        if again is not None:  # of two cameras, too: no noise is the same
            what, other = f"photo {k + 1}, {photo.viewpoint.name!r},", f"pixel by pixel {again.viewpoint.name!r} again"
            raise UnusablePhoto(what, other, "each picture once: what it shows is no evidence twice")


def faults_in(photos: Sequence[Photo]) -> dict[int, str]:
    """Return what is wrong with photos without contrast, or of black and white pixels, by their numbers."""
    faults = {}
    for number, photo in enumerate(photos):
        try:
            check_exposure(photo)
        except UnusablePhoto as error:
            faults[number] = str(error)
    return faults


def check_exposure(photo: Photo) -> None:
    """Raise `UnusablePhoto` for a photo without contrast, or of black and white pixels."""
    every = max(1, math.isqrt(photo.gray.size // _LOOKED_AT))
    name, gray = f"photo {photo.viewpoint.name!r}", photo.gray[::every, ::every].copy()
    low, high = quantile(gray, 0.01), quantile(gray, 0.99)
    if high - low < _FLAT:
        said = f"empty: 98 % of it lies within {low:.3f} to {high:.3f} of white"
        raise UnusablePhoto(name, said, "a picture with contrast")
    clipped = float(np.mean((gray <= 0.001) | (gray >= 0.999)))
    if clipped > _CLIPPED:
        raise UnusablePhoto(name, f"{clipped:.0%} black or white", "a picture exposed so that edges show")
