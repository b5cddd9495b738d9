"""Results that must not be returned: points at one pixel, that fit only a mirrored camera, or are nearly flat."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.observations import Observations
from cadcam.errors import DegenerateGeometry, MirroredPoints, NotConverged
from cadcam.fit.extents import flatness

_UNSUSPICIOUS_PX = 0.5  # rms of a coordinate that is accepted where no sigma is stated
_UNSUSPICIOUS_SIGMAS = 3.0
_TIMES_LIKELIER = 1e3
_ROUNDING = 1e-12  # of a pixel's coordinates
_NEARLY_FLAT = 0.02  # thickness over length
_USELESS = 1 / 3  # relative sigma of the focal length


def refuse_mirrored(
    observations: Observations,
    width: int,
    free: tuple[str, ...],
    sum_of_squares: float,
    mirrored_sum: Callable[[Array], float],
) -> None:
    """Raise `MirroredPoints` if the points seen in a mirror fit, and are a thousand times likelier.

    sum_of_squares: the best of real cameras, px^2; mirrored_sum: gives the best for given pixels. With dof degrees of
    freedom and unknown noise the likelihood is proportional to (sum of squares)^(-dof/2). A flat target cannot show it:
    its mirror image is the target seen from behind.
    """
    n, sigma = len(observations), observations.sigma_px
    doubt = _UNSUSPICIOUS_PX if sigma is None else _UNSUSPICIOUS_SIGMAS * sigma
    dof = 2 * n - len(free)
    if dof <= 0 or sum_of_squares <= 2 * n * doubt**2:
        return
    try:
        mirrored = mirrored_sum(mirror(observations.q, width))
    except NotConverged:
        return
    if (mirrored / sum_of_squares) ** (dof / 2) * _TIMES_LIKELIER < 1:
        raise MirroredPoints(
            f"the points fit a mirrored camera (residual {np.sqrt(mirrored / n):.3g} px) better than any real one "
            f"({np.sqrt(sum_of_squares / n):.3g} px): the world frame is left-handed or the image is mirrored "
            "(columns for U and V exchanged, or rows counted upwards)"
        )


def refuse_one_pixel(observations: Observations, *, where: str = "") -> None:
    """Raise `DegenerateGeometry` for different points that are all seen at one place; where: names the view."""
    q = observations.q
    if len(q) and float(np.ptp(q, axis=0).max()) <= _ROUNDING * (1 + float(np.abs(q).max())):
        x, y = q[0]
        raise DegenerateGeometry(
            f"all {len(q)} points{where} are seen at one pixel, x = {x:.6g}, y = {y:.6g} px: no camera near them does "
            "that; are the columns of the pixels the right ones?"
        )


def mirror(q: Array, width: int) -> Array:
    """Return the pixels (N, 2) as a mirror shows them, columns counted from the right."""
    return np.column_stack([width - 1 - q[:, 0], q[:, 1]])


def mirrored_internals(fixed: Mapping[str, float], width: int) -> dict[str, float]:
    """Return the fixed values that describe the same camera in the mirror."""
    values = dict(fixed)
    if "V0" in values:
        values["V0"] = width - 1 - values["V0"]
    if "skew" in values:
        values["skew"] = -values["skew"]
    return values


def refuse_as_good_as_flat(estimate: CameraEstimate) -> None:
    """Raise `DegenerateGeometry` for points so nearly on a plane that noise hides the focal length.

    Points in space are accepted however uncertain they leave it: the estimate's sigmas state this.
    """
    if "focal" not in estimate.free or not np.isfinite(estimate.noise_px):
        return
    thickness = flatness(estimate.observations.p_world)
    focal, sigma = estimate.value("focal"), estimate.sigma("focal")
    if thickness < _NEARLY_FLAT and sigma > _USELESS * focal:
        raise DegenerateGeometry(
            f"the world points are as good as coplanar (thickness by length {thickness:.2g}): they give a focal length "
            f"of {focal:.4g} +- {sigma:.2g} px at {estimate.noise_px:.2g} px of noise; fix the internals to get a "
            "pose, or add points at other heights"
        )
