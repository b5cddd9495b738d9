"""Marks of a plate that are not where the other marks have them: read wrongly, taken for another, or moved.

The residuals r of a position's fit have the covariance M V M^T: M = 1 - J C J^T takes off what the fit absorbs (J:
pixels by the matrix' entries, C: their cofactor), V is what may move the marks' pixels, noise and the plate's making. A
single mark k that is off shows in r_k^T (M V M^T)_kk^-1 r_k, else chi-square with two degrees of freedom, and is off by
M_kk^-1 r_k (data snooping; W. Baarda, Netherlands Geodetic Commission 2/5, 1968).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.station.plane import PlaneCalibration

_SURE = 30.0  # chi-square from which a mark is doubted: reached by chance once in three million marks
_RIVAL = 0.9  # of the largest chi-square, from which another mark may as well be the one that is off
_KNOWN = 1e-6  # least redundancy: of four marks the fit absorbs whatever is wrong with any


@dataclass(frozen=True, slots=True)
class Astray:
    """The mark of a position that fits worst: by how many px, and the sigma (px) to expect; rivals: equally suspect."""

    position: str
    mark: str
    off_px: float
    expected_px: float
    rivals: tuple[str, ...] = ()


def marks_astray(positions: Sequence[PlaneCalibration]) -> tuple[Astray, ...]:
    """Return the worst mark of each position in which one is surely off, for the noise and the plate's sigma_mm.

    Noise that is not stated is the median over all positions, so that one wrong mark does not excuse itself.
    """
    noise = [one.estimate.noise_px for one in positions if np.isfinite(one.estimate.noise_px)]
    if not noise:
        return ()
    found = [_worst(one, float(np.median(noise))) for one in positions]
    return tuple(one for one in found if one is not None)


def _worst(one: PlaneCalibration, noise_px: float) -> Astray | None:
    fit, names = one.estimate, one.estimate.observations.names
    _, by_point, by_entry = one.camera.project_with_jacobians(fit.observations.p_world[:, :2])
    J = by_entry.reshape(-1, 9)
    left = np.eye(len(J)) - J @ fit.cofactor @ J.T
    V = noise_px**2 * np.eye(len(J))
    for k, B in enumerate(by_point):
        V[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += one.placement.plate.sigma_mm**2 * B @ B.T
    expected, redundant = _own(left @ V @ left.T), _own(left)
    r = fit.residuals
    chi2 = np.einsum("ki,kij,kj->k", r, _inverse(expected, _KNOWN * noise_px**2), r)
    k = int(np.argmax(chi2))
    if chi2[k] < _SURE:
        return None
    back = _inverse(redundant[k], _KNOWN)
    sigma = float(np.sqrt(np.trace(back @ expected[k] @ back.T) / 2))
    rivals = tuple(names[i] for i in np.flatnonzero(chi2 > _RIVAL * chi2[k]) if i != k)
    return Astray(one.name, names[k], float(np.linalg.norm(back @ r[k])), sigma, rivals)


def _inverse(S: Array, least: float) -> Array:
    """Return the inverse (..., 2, 2) of symmetric S in the directions in which it is more than `least`, else 0."""
    w, V = np.linalg.eigh(S)
    return np.asarray((V * np.where(w > least, 1 / np.maximum(w, least), 0.0)[..., None, :]) @ np.swapaxes(V, -1, -2))


def _own(S: Array) -> Array:
    """Return the blocks (K, 2, 2) of each mark on the diagonal of S (2 K, 2 K)."""
    K = len(S) // 2
    return S.reshape(K, 2, K, 2)[np.arange(K), :, np.arange(K)]
