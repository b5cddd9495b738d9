"""What is wrong with a photo in which nothing can be found: said in words, with the number behind them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.image.picture import to_gray

_FLAT = 0.01  # standard deviation of grey values below which there is nothing to see
_BURNT = 0.5  # share of pixels at white or black above which too little is left
_WHITE, _BLACK = 0.995, 0.005
_SOFT = 4.0  # px: an edge blurred by more has no place to speak of
_STEEP = 0.002  # share of the pixels whose slopes tell the blur
_SMALLEST = 3  # px along a side
_SPAN = 25  # px: window in which an edge goes from dark to bright


def faults_of(picture: npt.ArrayLike) -> list[str]:
    """Return what speaks against finding edges in a picture: nothing to see, burnt out, dark, or out of focus."""
    gray = to_gray(picture)
    found = []
    white, black = float(np.mean(gray >= _WHITE)), float(np.mean(gray <= _BLACK))
    if white > _BURNT:
        found.append(f"it is overexposed: {100 * white:.0f} % of its pixels are white")
    if black > _BURNT:
        found.append(f"it is too dark: {100 * black:.0f} % of its pixels are black")
    if min(gray.shape) < _SMALLEST:
        return [*found, f"it is {gray.shape[1]} x {gray.shape[0]} px: there is no room for edges"]
    spread = float(gray.std())
    if spread < _FLAT:
        return [*found, f"it is empty: grey values vary by {spread:.4f} of white (standard deviation)"]
    blur = blur_px(gray)
    if blur > _SOFT:
        found.append(f"it is out of focus or moved: its sharpest edges are blurred by {blur:.1f} px")
    return found


def blur_px(picture: npt.ArrayLike) -> float:
    """Return the blur (standard deviation, px) of a picture's sharper edges: a tenth of its steep places is sharper.

    A step of contrast c blurred by a Gaussian of sigma b has the slope c / (sqrt(2 pi) b).
    """
    from scipy import ndimage

    gray = ndimage.uniform_filter(to_gray(picture), 3)
    slope = np.hypot(*np.gradient(gray))
    steep = slope >= np.quantile(slope, 1 - _STEEP)
    steep &= slope > 0
    if not steep.any():
        return float("inf")
    contrast = ndimage.maximum_filter(gray, _SPAN) - ndimage.minimum_filter(gray, _SPAN)
    return float(np.quantile(contrast[steep] / (np.sqrt(2 * np.pi) * slope[steep]), 0.1))
