"""The lens without distortion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cadcam.arrays import Array, Floats, component_major
from cadcam.camera.lens.base import Lens
from cadcam.camera.perspective import by_point, direction, perspective, perspective_and_scale


@dataclass(frozen=True, repr=False)
class Ideal(Lens):
    """The pinhole without distortion: m = (x, y)/z."""

    name: ClassVar[str] = "ideal"

    @property
    def valid_radius(self) -> float:
        """Return inf: every point in front is imaged."""
        return np.inf

    def project(self, p: Floats) -> Array:
        """Return (x, y)/z; NaN for z <= 0."""
        return perspective(p)

    def project_with_jacobians(self, p: Floats, terms: Sequence[int] | None = None) -> tuple[Array, Array, Array]:
        """Return m, dm/dp and an empty coefficient Jacobian."""
        u, over_z = perspective_and_scale(p)
        identity = component_major(u.shape[:-1], 2, 2)
        identity[..., 0, 0] = identity[..., 1, 1] = 1.0
        return u, by_point(identity, u, over_z), np.zeros((*u.shape, 0))

    def unproject(self, m: Floats) -> Array:
        """Return the unit direction of (mx, my, 1)."""
        return direction(np.asarray(m, dtype=np.float64))
