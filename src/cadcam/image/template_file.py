"""A template from a picture file: what is transparent in it is not part of it.

A template is often cut out along its outline, in a program that leaves the rest transparent. Laid over white, as photos
are, that rest would be matched as well: a round thing would be looked for on a white square.
"""

from __future__ import annotations

import os

import numpy as np

from cadcam.arrays import Mask, Picture
from cadcam.errors import BadValue
from cadcam.image.camera_picture import read_camera_picture
from cadcam.image.decode import finished, stored
from cadcam.image.picture import MAX_PIXELS, file_bytes, read_picture, to_gray
from cadcam.image.template import Template

_COUNTS = 0.5  # grey or opacity above which a pixel counts
_TRANSPARENT = (2, 4)  # channels of a picture with transparency


def read_template(path: str | os.PathLike[str], *, mask: str | os.PathLike[str] | None = None) -> Template:
    """Return the template in a picture file; pixels less than half opaque do not count.

    mask: a picture of the same size in which those that do not count are dark or transparent; a shape in one dark
    colour on nothing is what counts. White may be any: correlation is normalised. Raises `UnreadableFile`, and
    `BadValue` for sizes that differ and for a template without contrast.
    """
    picture, opaque = _layers(path)
    gray = to_gray(read_camera_picture(path) if picture is None else picture)
    counts = np.ones(gray.shape, bool) if opaque is None else opaque
    if mask is not None:
        counts = counts & _mask(mask, gray.shape[::-1])
    return Template(gray, mask=counts)


def _mask(path: str | os.PathLike[str], expected: tuple[int, ...]) -> Mask:
    picture, opaque = _layers(path)
    gray = to_gray(read_picture(path) if picture is None else picture)
    if gray.shape[::-1] != expected:
        size = gray.shape[::-1]
        raise BadValue(os.fspath(path), f"{size[0]} x {size[1]} px", f"the template's {expected[0]} x {expected[1]} px")
    bright = gray > _COUNTS
    if opaque is None or opaque.all():
        return np.asarray(bright)
    return np.asarray(opaque & bright if (opaque & bright).any() else opaque)  # a black shape on nothing is that shape


def _layers(path: str | os.PathLike[str]) -> tuple[Picture | None, Mask | None]:
    """Return the colours of a picture with transparency, not laid over anything, and where it is opaque; else None."""
    held = stored(path, file_bytes(path), max_pixels=MAX_PIXELS)
    if held.samples.ndim == 2 or held.samples.shape[2] not in _TRANSPARENT:
        return None, None
    colours, opacity = (
        finished(path, held._replace(samples=part), held.white).picture
        for part in (held.samples[..., :-1], held.samples[..., -1])
    )
    return colours, np.asarray(opacity > _COUNTS)
