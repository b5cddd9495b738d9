"""The thesis' own routine for joint internals (Table 2.23), to compare the joint calibration with.

It mixes two matrices of the first position and keeps the mixture whose internals fit both positions best: a search
along one line of internals, not a minimum over them. Table 2.24 is its alpha = 0.5.
"""

from __future__ import annotations

from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.extended_pinhole import ExtendedPinhole


def mixture(first, second, size, alpha):
    """Return both positions' estimates with the internals of C(alpha) = (1 - alpha) C1 + alpha C1'.

    Both positions are calibrated by the thesis' transform (C23 = 1); the first takes the second's internals and gives
    C1' with externals refitted; C(alpha) is decomposed, and both positions' externals are refitted to its internals.
    """
    own, others = (calibrate_camera(v, size, method="dlt-c23") for v in (first, second))
    C1, C1_with_others = (e.extended_pinhole.matrix for e in (own, locate_camera(first, others.camera)))
    camera = ExtendedPinhole.from_matrix((1 - alpha) * C1 + alpha * C1_with_others).camera(size)
    return locate_camera(first, camera), locate_camera(second, camera)
