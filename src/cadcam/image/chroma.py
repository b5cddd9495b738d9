"""The colour of a picture without its brightness: two differences of its channels that are zero where it is grey.

What is black and white is flat here, however high its contrast is. A surface keeps its hue in shade and gloss (the
dichromatic reflection model: S. Shafer, Color Research and Application 10, 1985), and its chroma grows with the light
on it. The differences are not divided by the brightness: cameras lift and cut off what is dark, and codecs keep colour
at half the resolution.
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Picture
from cadcam.image.picture import checked

_LEAST = 1.5 / 255  # differences of channels that rounding makes


def chroma_of(picture: Picture) -> Picture | None:
    """Return red minus green and yellow minus blue (H, W, 2) of a picture (H, W, 3); None where it is all grey."""
    values = checked(picture)
    if values.ndim == 2:
        return None
    red, green, blue = np.moveaxis(values, 2, 0)
    out = np.stack([red - green, 0.5 * (red + green) - blue], axis=2)
    return out if float(np.abs(out).max()) > _LEAST else None
