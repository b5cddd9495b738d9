"""The shaded model without its background: with lines on it, over a colour or a photo, or transparent."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Brief, Picture
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.image.picture import to_rgb
from cadcam.render.lines.wireframe import Wireframe
from cadcam.render.overlay import Color, LineStyle, fitting, model_alone, overlay
from cadcam.render.view import View

# Half-transparent ink: edges separate faces of similar brightness without turning the picture into a drawing.
SOFT = LineStyle(color_by="one", color=(0.05, 0.08, 0.12), width=1.2, opacity=0.55, hidden_opacity=0.25)
_WHITE: Color = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Cutout(Brief):
    """A shaded model without a background: `alpha` (H, W) is its share of each pixel, `color` (H, W, 3) its light.

    `color` is premultiplied by alpha, so that compositing is color + (1 - alpha) * background.
    """

    camera: Camera
    color: Picture
    alpha: Picture

    @classmethod
    def of(cls, view: View) -> Cutout:
        """Return the cutout of a view with an image."""
        return cls(view.camera, model_alone(view), view.coverage)

    def with_lines(self, wireframe: Wireframe, *, style: LineStyle = SOFT) -> Cutout:
        """Return the cutout with a wireframe of the same view drawn on it, anti-aliased; lines count as the model."""
        ink = replace(style, color_by="one", color=_WHITE)
        share = overlay(self.alpha, wireframe, style=ink)[..., 0]
        return Cutout(self.camera, overlay(self.color, wireframe, style=style), share)

    def over(self, background: Color) -> Picture:
        """Return the model on one RGB colour in [0, 1]; (H, W, 3)."""
        if not all(0 <= c <= 1 for c in background) or len(background) != 3:
            raise BadValue("background", background, "red, green, blue from 0 to 1")
        return self._laid_over(np.array(background, np.float32))

    def over_photo(self, photo: npt.ArrayLike) -> Picture:
        """Return the model on a photo (H, W) or (H, W, 3) of the camera's size; `SizeMismatch` otherwise."""
        return self._laid_over(to_rgb(fitting(photo, self.camera)))

    @property
    def straight(self) -> Picture:
        """The model's own colour (H, W, 3), not premultiplied, as a PNG stores it; 0 where alpha is 0."""
        alpha = self.alpha[..., None]
        return np.asarray(np.divide(self.color, alpha, out=np.zeros_like(self.color), where=alpha > 0), np.float32)

    def _laid_over(self, background: Picture) -> Picture:
        out = np.multiply((1 - self.alpha)[..., None], background, dtype=np.float32)
        return np.add(self.color, out, out=out)
