"""The thesis' own routine for joint internals (Table 2.23), kept for comparison with `calibrate_jointly`.

It mixes two matrices of the first position and keeps the mixture whose internals fit both positions best: a search
along one line of internals, not a minimum over them. Table 2.24 is its alpha = 0.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import ExtendedPinhole
from cadcam.camera.observations import Observations
from cadcam.errors import DegenerateGeometry

ALPHAS = tuple(float(a) for a in np.arange(-10, 21) / 10)


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """One alpha of the routine: the internals of C(alpha), and the best pose of both positions under them."""

    alpha: float
    camera: Camera
    first: CameraEstimate
    second: CameraEstimate

    @property
    def total(self) -> float:
        """Return the mean of the two positions' residuals, px."""
        return 0.5 * (self.first.thesis_residual + self.second.thesis_residual)


def thesis_mixtures(
    first: Observations, second: Observations, size: tuple[int, int], alphas: Sequence[float] = ALPHAS
) -> list[Mixture]:
    """Return the mixtures of Table 2.23 in the order of `alphas`; those that are not cameras are left out.

    Both positions are calibrated by the thesis' transform (C23 = 1); the first takes the second's internals and gives
    C1' with externals refitted; C(alpha) = (1 - alpha) C1 + alpha C1' is decomposed, and both positions' externals are
    refitted to its internals. alpha = 0 is Table 2.21, alpha = 1 Table 2.22. Raises what `calibrate_camera` raises.
    """
    own, others = (calibrate_camera(v, size, method="dlt-c23") for v in (first, second))
    C1 = own.extended_pinhole.matrix
    C1_with_others = locate_camera(first, others.camera).extended_pinhole.matrix
    found = []
    for alpha in alphas:
        try:
            camera = ExtendedPinhole.from_matrix((1 - alpha) * C1 + alpha * C1_with_others).camera(size)
        except DegenerateGeometry:
            continue
        found.append(Mixture(alpha, camera, locate_camera(first, camera), locate_camera(second, camera)))
    return found
