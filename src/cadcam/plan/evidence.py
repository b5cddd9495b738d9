"""What cameras tell of features, as information that adds up: 3x3 for each camera and feature.

A feature is displaced by x (3,). In one picture it is measured by rows i, each the offset along a unit vector n_i of
the picture with variance v_i, which x moves by a_i . x; all rows of a feature are shifted by the same b (2,) px where
the camera itself errs. So three sums hold all that a picture tells,

    N = sum a a^T/v      X = sum a n^T/v      Y = sum n n^T/v

Let b = E t with numbers t of unit variance, those of calibrations and motions, which cameras may share. Then x has the
information

    sum N  -  (sum X E) (1 + sum E^T Y E)^-1 (sum X E)^T

over all cameras: exactly that of weighted least squares with covariance diag(v) + A A^T, by Woodbury's identity. Where
no two cameras share a number, it is the sum of what it is for each alone: what a search for cameras adds up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The sums N (..., 3, 3), X (..., 3, 2), Y (..., 2, 2) of features in pictures; zero where nothing is seen."""

    N: Array
    X: Array
    Y: Array

    @classmethod
    def of_points(cls, J: Array, noise: Array) -> Evidence:
        """Return that of points: J (..., 2, 3) px/mm, noise (..., 2, 2) px^2 of their pixels."""
        W = np.linalg.inv(noise)
        X = np.swapaxes(J, -1, -2) @ W
        return cls(X @ J, X, W)

    def where(self, seen: Array) -> Evidence:
        """Return the evidence with zeros where a feature (...) is not seen."""
        keep = np.asarray(seen, bool)[..., None, None]
        return Evidence(*(np.where(keep, part, 0.0) for part in (self.N, self.X, self.Y)))

    def alone(self, S: Array) -> Array:
        """Return the information (..., 3, 3) of each camera by itself, its shift of covariance S (..., 2, 2) px^2."""
        inner = S @ np.linalg.inv(np.eye(2) + self.Y @ S)
        return symmetric(self.N - self.X @ inner @ np.swapaxes(self.X, -1, -2))


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """What V cameras tell together: covariance (n, 3, 3), and the gains by which errors enter it.

    from_pixels (n, 3, 3): the part of the covariance that is due to pixels. by_number (n, 3, P): how the estimate moves
    with each number t of unit variance.
    """

    covariance: Array
    from_pixels: Array
    by_number: Array


def together(evidence: Evidence, E: Array, prior: Array, *, basis: Array | None = None) -> Together:
    """Return what cameras (V, n) tell together; E (V, n, 2, P): how numbers of unit variance shift each picture.

    prior (n, 3, 3): information that is there before. basis (3, m): the directions in which features can be displaced
    at all; default every one. NaN where the sum of all still leaves a direction open.
    """
    XE = np.einsum("vnij,vnjp->nip", evidence.X, E, optimize=True)
    YE = np.einsum("vnji,vnjk,vnkp->nip", E, evidence.Y, E, optimize=True)
    weight = np.linalg.solve(np.eye(E.shape[-1]) + YE, np.swapaxes(XE, -1, -2))  # (n, P, 3)
    total = evidence.N.sum(axis=0)
    B = np.eye(3) if basis is None else basis
    C = B @ inverse(symmetric(B.T @ (total + prior - XE @ weight) @ B)) @ B.T
    # one camera's gain C (X^T - weight^T E^T Y): summed over the cameras for pixels, and for each number
    bound = np.swapaxes(weight, -1, -2)
    pixels = C @ (total - XE @ weight - bound @ np.swapaxes(XE, -1, -2) + bound @ YE @ weight) @ C
    numbers = C @ (XE - bound @ YE)
    return Together(C, symmetric(pixels), numbers)


def inverse(information: Array) -> Array:
    """Return the inverse (..., m, m), NaN where it is singular for its size."""
    size = np.trace(information, axis1=-2, axis2=-1)[..., None, None]
    scaled = information / np.where(size > 0, size, 1.0)
    w = np.linalg.eigvalsh(np.where(np.isfinite(scaled), scaled, 0.0))[..., 0]
    good = (w > 1e-13)[..., None, None] & (size > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(
            np.where(good, np.linalg.inv(np.where(good, scaled, np.eye(information.shape[-1]))) / size, np.nan)
        )


def symmetric(M: Array) -> Array:
    """Return the symmetric part (..., n, n)."""
    return np.asarray((M + np.swapaxes(M, -1, -2)) / 2)
