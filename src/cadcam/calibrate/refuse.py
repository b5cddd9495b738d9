"""Results that must not leave: points that fit only a mirrored camera, parameters that the points do not determine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import EXTERNALS
from cadcam.errors import DegenerateGeometry, MirroredPoints, NotConverged
from cadcam.fit.camera_model import CameraModel

_NEGLIGIBLE_PX = 1e-3  # residuals below this are as good as none
_TIMES_LIKELIER = 1e3

LowestSum = Callable[[CameraModel, Mapping[str, float]], float]


def refuse_mirrored(
    estimate: CameraEstimate, lowest_sum: LowestSum, model: CameraModel, fixed: Mapping[str, float]
) -> None:
    """Raise `MirroredPoints` if the points seen in a mirror are a thousand times likelier.

    `lowest_sum` solves the mirrored problem. With dof degrees of freedom and unknown noise the likelihood goes with
    (sum of squares)^(-dof/2). A flat target cannot show it: its mirror image is the target seen from behind.
    """
    if estimate.dof <= 0 or any(name in fixed for name in EXTERNALS):
        return
    width = estimate.camera.width
    negligible = model.q.size * _NEGLIGIBLE_PX**2
    if estimate.sum_of_squares <= negligible:
        return
    seen = np.column_stack([width - 1 - model.q[:, 0], model.q[:, 1]])
    values = dict(fixed)
    if "V0" in values:
        values["V0"] = width - 1 - values["V0"]
    if "skew" in values:
        values["skew"] = -values["skew"]
    try:
        mirrored = lowest_sum(replace(model, q=seen), values)
    except NotConverged:
        return
    ratio = (mirrored + negligible) / (estimate.sum_of_squares + negligible)
    if ratio ** (estimate.dof / 2) * _TIMES_LIKELIER < 1:
        n = len(model.q)
        raise MirroredPoints(
            f"the points fit a mirrored camera (residual {np.sqrt(mirrored / n):.3g} px) better than any real one "
            f"({estimate.thesis_residual:.3g} px): the world frame is left-handed or the image is mirrored (columns "
            f"for U and V "
            "exchanged, or rows counted upwards)"
        )


def refuse_undetermined(estimate: CameraEstimate) -> None:
    """Raise `DegenerateGeometry` if the focal length is more uncertain than it is long: no perspective is seen."""
    if "focal" not in estimate.free or not np.isfinite(estimate.noise_px):
        return
    focal, sigma = estimate.value("focal"), estimate.sigma("focal")
    if sigma > focal:
        raise DegenerateGeometry(
            f"the points do not determine the focal length: {focal:.4g} +- {sigma:.2g} px at {estimate.noise_px:.2g} "
            f"px of "
            "noise; fix it, or add points at other depths"
        )
