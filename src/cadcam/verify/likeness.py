"""How much photos look like the part with its bodies drawn in some places: surfaces as bright as the light makes them.

Edges alone are taken for each other where a displacement brings one near another's place. What lies between them is
not: a wrong guess leaves strips of a wrong tone beside every edge. Places of a body are compared by all pixels that it
covers in any of them. Neighbouring pixels are off together, and some by anything: their squared residuals are bounded,
and each counts as a small part of an observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import noise_of
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.light import fitted_light, surfaces
from cadcam.verify.tones import Drawn

_RIM_PX = 4  # around a body's picture that counts too
_BLUR_PX = 0.7  # of the photo, about
_WORST = 9.0  # squared sigmas that a pixel is off at most
_TOGETHER = 12.0  # pixels that count as one


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """Photos of a part at a pose, and the pixels (H, W) of each that are compared."""

    photos: Sequence[Photo]
    world_from_part: Rigid
    where: Sequence[Mask]

    @classmethod
    def around(cls, photos: Sequence[Photo], world_from_part: Rigid, guesses: Sequence[Part], body: int) -> Likeness:
        """Return what is compared where a body is drawn in several places, of whichever parts show it."""
        from scipy.ndimage import binary_dilation

        where = []
        for photo in photos:
            pose = photo.viewpoint.camera_from_world @ world_from_part
            covered = np.any([Drawn.of(part, photo, pose).part == body for part in guesses], axis=0)
            where.append(binary_dilation(covered, iterations=_RIM_PX) if covered.any() else covered)
        return cls(photos, world_from_part, where)

    def of(self, part: Part, *, without: int = -1) -> float:
        """Return the logarithm of the likelihood of the pixels compared, up to a constant; without: a body left out."""
        return sum(self._in_photo(part, i, without) for i in range(len(self.photos)))

    def _in_photo(self, part: Part, number: int, without: int) -> float:
        from scipy.ndimage import gaussian_filter

        photo, where = self.photos[number], self.where[number]
        if not where.any():
            return 0.0
        drawn = Drawn.of(part, photo, photo.viewpoint.camera_from_world @ self.world_from_part, without=without)
        light = fitted_light(photo.gray, drawn.normal, drawn.color, without=where)
        rows, columns = (slice(max(int(i.min()) - 2, 0), int(i.max()) + 3) for i in np.nonzero(where))
        normal, color = drawn.normal[rows, columns], drawn.color[rows, columns]
        kind, first, at = np.unique(
            surfaces(normal.reshape(-1, 3), color.ravel()), return_index=True, return_inverse=True
        )
        tone, V = light.brightness(normal.reshape(-1, 3)[first], color.ravel()[first])
        tone[color.ravel()[first] < 0] = light.nothing
        sigma = np.sqrt(np.diag(V) + noise_of(photo.gray) ** 2)
        image = gaussian_filter(tone[at].reshape(color.shape), _BLUR_PX, mode="nearest")
        off = ((photo.gray[rows, columns] - image) / sigma[at].reshape(color.shape)) ** 2
        loss = np.minimum(off, _WORST) + 2 * np.log(sigma[at].reshape(color.shape))
        return float(-0.5 * loss[where[rows, columns]].sum() / _TOGETHER)
