"""A nonlinear camera response, a gamma: it moves every step towards its dark side, up to a third of a pixel.

With brightness y = L^(1/g) of the light L, light halfway between that of two sides looks brighter than halfway between
y1 and y2. To first order in g - 1 the middle of a blurred step is higher by (g - 1) (y2 - y1)^2 / (4 (y1 + y2)), and a
step of blur s fitted to it by least squares is off along its normal by

    (g - 1) h,   h = -K s (y2 - y1) / (y1 + y2),   K = sqrt(pi) / 3,

because the term added to the step, Phi (1 - Phi), has 1/6 of the slope's weight and the slope itself 1 / (2 sqrt(pi)).

At a single pose, edges of different sign and contrast contradict each other: g - 1 follows from the common offsets of
edges, to 0.05 to 0.4. The hypothesis of a gamma is weighed against none by how well each explains these (a Bayes
factor: R. Kass and A. Raftery, J. Am. Stat. Assoc. 90, 1995). The expected value is removed, so that without a gamma
nothing changes, and the remaining doubt goes into the covariance, also where nothing is removed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.fit.grouped import GroupedFit
from cadcam.locate.lines.cells import StepOffsets
from cadcam.locate.lines.edges import Projected
from cadcam.locate.lines.sight import Sight
from cadcam.native.profiles import values_at

_OF_BLUR = np.sqrt(np.pi) / 3
_BESIDE = 3.0  # blurs from the line at which the sides have their own brightness
_USUAL = (0.8, 0.6)  # g - 1 of cameras with a nonlinear response, mean and sd
_SELDOM = 0.25  # prior odds of such a camera
_NEVER = 1e-6  # posterior share of such cameras below which a nonlinear response is ruled out
_DOUBT = 0.5  # probability of a nonlinear response up to which it is not removed, only doubted
_LEAST = 5.0  # fewest degrees of freedom that are evidence
_LIGHT = 0.05  # share of the variance of edges' offsets by light that draws all towards dark, or towards bright


@dataclass(frozen=True, slots=True)
class Bend:
    """A camera response y = L^(1/g): the excess g - 1 to be removed, and its uncertainty (rms)."""

    excess: float
    sd: float


def leanings(sight: Sight, at: Projected, which: Longs, blur: float) -> Array:
    """Return the shift (n,) px along the normal of each chosen sample's step per unit of g - 1."""
    q, aside = at.q[which], _BESIDE * blur * at.normal[which]
    low, high = values_at(sight.photo.gray[..., None], np.stack([q - aside, q + aside]))[..., 0]
    lean = -_OF_BLUR * blur * (high - low) / np.maximum(high + low, 1e-3)
    return np.asarray(np.nan_to_num(lean))


def bend_of(fit: GroupedFit, J: Array, lean: Array, bright: Array, group: Longs) -> Bend | None:
    """Return the nonlinear response shown by the residuals of a fit without one; None where they rule it out.

    J (n, k), lean (n,), group (n,): of some samples of each edge, and the number of its group in the fit. Regression of
    the groups' offsets on their derivatives by the pose and by g - 1. bright (n,): 1 or -1, the side of a sample on
    which the photo is brighter; light that draws all edges slightly towards one of these looks similar.
    """
    of, place = np.unique(group, return_inverse=True)
    n = np.bincount(place, minlength=1)
    root = np.sqrt(fit.of_group[of] / (fit.sd_offset[of] ** 2 + fit.off[of] ** 2))
    drawn = np.sqrt(_LIGHT) * fit.off[group] * bright
    *pose, h, light = [root * np.bincount(place, column) / n for column in (*J.T, lean, drawn)]
    r = root * fit.offset[of]
    A = np.array(pose).T
    h, r = (v - A @ np.linalg.lstsq(A, v)[0] for v in (h, r))
    dof = float(fit.of_group[of].sum()) - A.shape[1] - 1
    if dof < _LEAST or not h @ h > 0:
        return None
    excess = float(h @ r / (h @ h))
    by_light = float(h @ light / (h @ h))
    return _weighed(excess, float(np.sum((r - excess * h) ** 2) / (dof - 2) / (h @ h)) + by_light**2)


def _weighed(excess: float, variance: float) -> Bend | None:
    """Return the expected value given a measured one with this variance, None where there is no gamma."""
    usual, sd = _USUAL
    total = variance + sd**2
    mean, left = (excess * sd**2 + usual * variance) / total, variance * sd**2 / total
    above = _above(mean / np.sqrt(left))  # of the posterior's mass, above zero and below the usual range
    if not above > _NEVER:
        return None
    log_factor = 0.5 * (np.log(variance / total) + excess**2 / variance - (excess - usual) ** 2 / total)
    log_factor += np.log(above / _above(usual / sd))
    there = float(np.exp(-np.logaddexp(0.0, -np.log(_SELDOM) - log_factor)))
    hazard = float(np.exp(-0.5 * mean**2 / left)) / (np.sqrt(2 * np.pi) * above)
    mean, left = mean + np.sqrt(left) * hazard, left * (1 - hazard * (hazard + mean / np.sqrt(left)))
    if there < _DOUBT:
        return Bend(0.0, float(np.sqrt(there * (left + mean**2))))
    return Bend(there * mean, float(np.sqrt(there * (left + (1 - there) * mean**2))))


def _above(z: float) -> float:
    """Return the share of a normal distribution that lies above 0, z standard deviations below its mean."""
    return 0.5 * math.erfc(-z / math.sqrt(2))


def straightened(measured: Sequence[StepOffsets], leans: Sequence[Array], bend: Bend) -> list[StepOffsets]:
    """Return the steps where a straight response would show them."""
    out = []
    for m, lean in zip(measured, leans, strict=True):
        offset = m.offset.copy()
        offset[m.usable] -= bend.excess * lean
        out.append(replace(m, offset=offset))
    return out
