"""What pictures tell of features, as information that adds up: 3x3 for each camera and feature.

A feature is displaced by x (3,). Its picture is then displaced by J x (2,) px, with the information W (2, 2) that the
noise of its pixels allows: of rank two for a point, of rank one for a straight edge. Errors of the camera shift the
picture there by b = E t, with independent t of unit variance: the errors of calibrations and motions, which cameras may
share. Then x has the information

    sum J^T W J  -  (sum J^T W E) (1 + sum E^T W E)^-1 (sum J^T W E)^T

summed over all cameras: exactly that of weighted least squares with covariance W^-1 + E E^T, by Woodbury's identity.
Where no two cameras share an error, it is the sum of each camera's own information, which a search for cameras adds up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """J (..., 2, 3) px/mm and W (..., 2, 2) 1/px^2 of features in pictures; zero where nothing is seen."""

    J: Array
    W: Array

    def where(self, seen: Mask) -> Evidence:
        """Return the evidence with zeros where a feature (...) is not seen."""
        keep = np.asarray(seen, bool)[..., None, None]
        return Evidence(np.where(keep, self.J, 0.0), np.where(keep, self.W, 0.0))

    def alone(self, S: Array) -> Array:
        """Return the information (..., 3, 3) of each camera alone, its shift of covariance S (..., 2, 2) px^2."""
        inner = self.W @ np.linalg.inv(np.eye(2) + S @ self.W)
        return symmetric(np.swapaxes(self.J, -1, -2) @ inner @ self.J)


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """The joint estimate by V cameras: covariance (n, 3, 3), and the gains by which errors enter it.

    from_pixels (n, 3, 3): the part of the covariance that is due to pixels. by_number (n, 3, P): derivative of the
    estimate by each error t of unit variance.
    """

    covariance: Array
    from_pixels: Array
    by_number: Array


def together(evidence: Evidence, E: Array, prior: Array, *, basis: Array | None = None) -> Together:
    """Return what cameras (V, n) tell together; E (V, n, 2, P): shift of each picture by each error of unit variance.

    prior (n, 3, 3): information beside that of the pictures. basis (3, m): the directions in which features can be
    displaced, by default all. NaN where the sum of all leaves a direction undetermined.
    """
    Jt, WE = np.swapaxes(evidence.J, -1, -2), evidence.W @ E
    total = (Jt @ evidence.W @ evidence.J).sum(axis=0)
    XE = (Jt @ WE).sum(axis=0)
    YE = (np.swapaxes(E, -1, -2) @ WE).sum(axis=0)
    weight = np.linalg.solve(np.eye(E.shape[-1]) + YE, np.swapaxes(XE, -1, -2))  # (n, P, 3)
    B = np.eye(3) if basis is None else basis
    rounded = np.trace(total + prior, axis1=-2, axis2=-1)  # what is left of it after the errors is rounded by its size
    C = B @ inverse(symmetric(B.T @ (total + prior - XE @ weight) @ B), rounded) @ B.T
    # a camera's gain is C (J^T - weight^T E^T) W: squared and summed over cameras for pixels, for each error times E
    bound = np.swapaxes(weight, -1, -2)
    pixels = C @ (total - XE @ weight - bound @ np.swapaxes(XE, -1, -2) + bound @ YE @ weight) @ C
    return Together(C, symmetric(pixels), C @ (XE - bound @ YE))


def inverse(information: Array, size: Array) -> Array:
    """Return the inverse (..., m, m), NaN where it is singular for the size (...) of what it was computed from."""
    size = size[..., None, None]
    scaled = information / np.where(size > 0, size, 1.0)
    w = np.linalg.eigvalsh(np.where(np.isfinite(scaled), scaled, 0.0))[..., 0]
    good = (w > 1e-13)[..., None, None] & (size > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        safe = np.where(good, scaled, np.eye(information.shape[-1]))
        return np.asarray(np.where(good, np.linalg.inv(safe) / size, np.nan))


def symmetric(M: Array) -> Array:
    """Return the symmetric part (..., n, n)."""
    return np.asarray((M + np.swapaxes(M, -1, -2)) / 2)
