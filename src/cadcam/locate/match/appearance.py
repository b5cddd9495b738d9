"""What is compared of a photo and of a rendered part: appearances that are alike although the lighting differs.

"lines": the part's visible lines, drawn, with the photo's gradient magnitude. "gradient": the gradient magnitude of
the shaded part with the photo's. "gray": the shaded part with the photo, of either contrast; for parts painted as the
model says and lit alike. Gradients are saturated, m/(m + c), so that the strongest edge does not outweigh all others.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from cadcam.arrays import Mask, Picture
from cadcam.render.lines.wireframe import Wireframe
from cadcam.render.view import View

Appearance = Literal["lines", "gradient", "gray"]
APPEARANCES: tuple[Appearance, ...] = get_args(Appearance)

_BLUR = 1.0  # px, sigma of the Gaussian derivatives and of drawn lines
_FAINT = 3.0  # median gradients: the magnitude c that counts half
_LEAST_FAINT = 0.01  # grey value per px, the least c: quantisation
_LINE_PX = 1.5
_DRAWN, _BESIDE_LINE = 0.3, 6  # grey value that counts as a line; px compared to each side of one
_BEYOND = 4  # px compared outside the outline: enough to show it, little of the background


def of_photo(gray: Picture, kind: Appearance) -> Picture:
    """Return the appearance of a photo (H, W)."""
    if kind == "gray":
        return _blurred(gray, 0.7)
    magnitude = _gradient(gray)
    return _saturated(magnitude, max(_FAINT * float(np.median(magnitude)), _LEAST_FAINT))


def of_model(view: View, wireframe: Wireframe, kind: Appearance) -> Picture:
    """Return the appearance of the part, from its rendered view (IMAGE) or its lines."""
    if kind == "gray":
        return _blurred(view.gray, 0.7)
    if kind == "gradient":
        return _saturated(_gradient(view.gray), _LEAST_FAINT)
    from cadcam.image.draw import draw_polylines

    blank = np.zeros((view.camera.height, view.camera.width), np.float32)
    drawn = draw_polylines(blank, wireframe.visible.lines, color=(1.0, 1.0, 1.0), width=_LINE_PX)[..., 0]
    drawn = _blurred(drawn, _BLUR)
    return np.asarray(drawn / max(float(drawn.max()), 1e-6), np.float32)


def counted(view: View, drawing: Picture, kind: Appearance) -> Mask:
    """Return which pixels of a drawing by `of_model` are compared: elsewhere the model does not determine the photo.

    For lines, the pixels near them: faces may be printed on, dirty, or welded. For shades, the part without its border.
    """
    from scipy.ndimage import binary_dilation, binary_erosion

    if kind == "gray":
        return np.asarray(binary_erosion(view.coverage >= 1, iterations=1))
    determined: Mask = binary_dilation(view.coverage > 0, iterations=_BEYOND)
    return np.asarray(
        determined & binary_dilation(drawing > _DRAWN, iterations=_BESIDE_LINE) if kind == "lines" else determined
    )


def _gradient(gray: Picture) -> Picture:
    from scipy.ndimage import gaussian_filter1d

    def along(axis: int) -> Picture:
        smooth = gaussian_filter1d(gray, _BLUR, axis=1 - axis, mode="nearest")
        return np.asarray(gaussian_filter1d(smooth, _BLUR, axis=axis, order=1, mode="nearest"), np.float32)

    return np.hypot(along(1), along(0))


def _saturated(magnitude: Picture, half: float) -> Picture:
    return np.asarray(magnitude / (magnitude + np.float32(half)), np.float32)


def _blurred(gray: Picture, sigma: float) -> Picture:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(gray, sigma, mode="nearest"), np.float32)
