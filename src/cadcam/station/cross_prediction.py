"""Every calibration predicts what every other saw, which separates mechanics from vision (Tables 6.9 to 6.11).

Calibration i, applied to the picture taken at position j, misses the surveyed marks there by d_ij. The difference of
the mechanics between the two places enters d_ji with the opposite sign; pixel noise and other independent errors do
not. So d_ij = m_i - m_j + e_ij, with the mechanics' deviation m and the vision's error e. Survey errors that shift a
whole plate look like mechanics: they enter the map's covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief, Floats, frozen
from cadcam.camera.error_source import ErrorSource
from cadcam.errors import BadValue, TooFewPoints
from cadcam.station.plane import PlaneCalibration


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Split(Brief):
    """Cross-predictions d (N, N, 2) mm split: d_ij = m_i - m_j + e_ij; row i predicts column j.

    mechanics (N, 2): m, where the view really is minus where the controller puts it, less the mean over all positions.
    vision (2,): standard deviation of the error of one prediction, from d_ij + d_ji. closure (2,): rms of the residuals
    of the antisymmetric parts about m_i - m_j: where all errors are independent, sqrt((N - 2) / 2N) of the vision's, so
    0.65 of it for twelve positions and 0 for two.
    """

    deviations: Array
    mechanics: Array
    vision: Array
    closure: Array

    @property
    def pairs(self) -> int:
        """Return how many pairs of positions there are."""
        n = len(self.mechanics)
        return n * (n - 1) // 2

    def pair(self, i: int, j: int) -> tuple[Array, Array]:
        """Return total (2,) = |d_ij - d_ji|/2 and camera error (2,) = |d_ij + d_ji| of a pair (Table 6.10)."""
        one, other = self.deviations[i, j], self.deviations[j, i]
        return np.abs(one - other) / 2, np.abs(one + other)

    @property
    def worst(self) -> float:
        """Return the largest difference of the mechanics between two positions, mm."""
        m = self.mechanics
        return float(np.linalg.norm(m[:, None] - m[None], axis=2).max())


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DeviationMap(Brief):
    """The mechanics' deviation (N, 2) mm at positions (N, 2), its covariance (2 N, 2 N) from survey and vision.

    deviation: relative to `reference`, the index of a position; None: to the mean of all (Fig 6-17, 6-18).
    vision (2,): rms error, mm, of a single mark predicted from another position, with the mechanics removed;
    predicted (2,): its expectation from pixels, survey and the plate's accuracy.
    """

    positions: Array
    deviation: Array
    covariance: Array
    split: Split
    vision: Array
    predicted: Array
    reference: int | None = None

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (N, 2) mm."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).reshape(-1, 2))


def cross_predictions(positions: Sequence[PlaneCalibration]) -> Array:
    """Return d (N, N, 2) mm: the mean error of calibration i at the marks surveyed at j."""
    out = np.zeros((len(positions),) * 2 + (2,))
    for j, seen in enumerate(positions):
        q, p = seen.estimate.observations.q, seen.placement.marks[list(seen.seen)]
        for i, one in enumerate(positions):
            out[i, j] = 0.0 if i == j else (one.predict(q, seen.position) - p).mean(axis=0)
    return out


def split(deviations: Floats) -> Split:
    """Return mechanics and vision of cross-predictions (N, N, 2), without the diagonal. Raises `TooFewPoints`."""
    d = np.array(frozen(deviations, "cross-predictions", (None, None, 2), finite=False))
    n = len(d)
    if d.shape[1] != n:
        raise BadValue("cross-predictions", f"of shape {d.shape}", "a square table of pairs")
    if n < 2:
        raise TooFewPoints("comparing calibrations", n, 2, of="positions")
    d[np.eye(n, dtype=bool)] = 0.0
    if not np.isfinite(d).all():
        raise BadValue("cross-predictions", "not finite", "every pair of positions")
    turned = np.swapaxes(d, 0, 1)
    m = (d - turned).sum(axis=1) / (2 * n)
    upper = np.triu_indices(n, 1)
    camera, left = (d + turned)[upper], ((d - turned) / 2 - (m[:, None] - m[None]))[upper]
    return Split(d, m, np.sqrt(np.mean(camera**2, axis=0) / 2), np.sqrt(np.mean(left**2, axis=0)))


def deviation_map(positions: Sequence[PlaneCalibration], *, reference: int | None = None) -> DeviationMap:
    """Return how the mechanics deviate at the calibrated positions, with the covariance from survey and vision."""
    n = len(positions)
    parts = split(cross_predictions(positions))
    if reference is not None and not 0 <= reference < n:
        raise BadValue("reference position", reference, f"a number from 0 to {n - 1}")
    less = np.full((n, n), 1 / n) if reference is None else np.eye(n)[[reference] * n]
    about = np.kron(np.eye(n) - less, np.eye(2))
    covariance = about @ view_covariance(positions) @ about.T
    m = parts.mechanics if reference is None else parts.mechanics - parts.mechanics[reference]
    grid = np.stack([one.position for one in positions])
    seen = _vision(positions, parts.mechanics)
    return DeviationMap(grid, m, covariance, parts, seen, _predicted(positions), reference)


def view_covariance(positions: Sequence[PlaneCalibration]) -> Array:
    """Return the covariance (2 N, 2 N) mm^2 of where each calibration sees the centre of its plate.

    Pixels and survey are independent between positions; the errors of the plate are common to all.
    """
    n = len(positions)
    out = np.zeros((2 * n, 2 * n))
    made = [_by_plate(one) for one in positions]
    for i, one in enumerate(positions):
        at = slice(2 * i, 2 * i + 2)
        moves = one.placement.moves(one.centre + one.position)
        out[at, at] = _from_pixels(one) + moves @ one.placement.covariance @ moves.T
        for j, other in enumerate(positions):
            if other.placement.plate is one.placement.plate:
                out[at, 2 * j : 2 * j + 2] += one.placement.plate.sigma_mm**2 * made[i] @ made[j].T
    return out


def plate_effect(one: PlaneCalibration, by_entry: Array, p: Array) -> Array:
    """Return the Jacobian (n, 2, 2 (K + M)) of world points p (n, 2) by the plate's marks and reflectors.

    In the plate's axes, marks before reflectors. by_entry (n, 2, 9): the points by the entries of the calibration.
    """
    placement, plate = one.placement, one.placement.plate
    R, K, M = placement.rotation, len(plate.marks), len(plate.reflectors)
    by_marks = np.zeros((9, K, 2))
    by_marks[:, list(one.seen)] = one.by_marks.reshape(9, -1, 2) @ R
    by_reflectors = (placement.gain.reshape(3, M, 2) @ R).reshape(3, 2 * M)
    return np.concatenate([by_entry @ by_marks.reshape(9, 2 * K), placement.moves(p) @ by_reflectors], axis=-1)


def _by_plate(one: PlaneCalibration) -> Array:
    """Return the derivative of where a calibration sees the centre of its plate by the plate's points."""
    _, by_entry = one.by_entries(one.centre[None])
    return np.asarray(plate_effect(one, by_entry, one.centre[None] + one.position)[0])


def _from_pixels(one: PlaneCalibration) -> Array:
    """Return the covariance (2, 2) mm^2 of where a calibration sees the centre of its plate, by its pixels' noise."""
    _, by_entry = one.by_entries(one.centre[None])
    known = np.isfinite(one.estimate.noise_px)
    covariance = one.estimate.covariance if known else np.zeros((9, 9))
    return np.asarray(by_entry[0] @ covariance @ by_entry[0].T)


def _vision(positions: Sequence[PlaneCalibration], mechanics: Array) -> Array:
    """Return the rms (2,) of single marks' errors in all cross-predictions, with the mechanics removed."""
    squares, count = np.zeros(2), 0
    for j, seen in enumerate(positions):
        q, p = seen.estimate.observations.q, seen.placement.marks[list(seen.seen)]
        for i, one in enumerate(positions):
            if i != j:
                off = one.predict(q, seen.position) - p - (mechanics[i] - mechanics[j])
                squares, count = squares + np.sum(off**2, axis=0), count + len(off)
    return np.asarray(np.sqrt(squares / count))


def _predicted(positions: Sequence[PlaneCalibration]) -> Array:
    """Return the expected standard deviation (2,) of single marks' errors about their mean."""
    each = [_scatter(one) for one in positions]
    return np.asarray(np.sqrt(np.concatenate(each).mean(axis=0)))


def _scatter(one: PlaneCalibration) -> Array:
    """Return the variances (K, 2) of another plate picture's marks about their mean, as measured by this one."""
    fit, plate, placement = one.estimate, one.placement.plate, one.placement
    noise = fit.noise_px if np.isfinite(fit.noise_px) else 0.0
    p = fit.observations.p_world[:, :2]
    back, by_entry = one.by_entries(p)
    K = len(back)
    # The effect (K, 2, ...) of each independent unit error, cause by cause, on the marks.
    their_pixels = np.einsum("kl,kxy->kxly", np.eye(K), noise * back).reshape(K, 2, 2 * K)
    calibration = noise * by_entry @ _root(fit.cofactor)
    itself = np.einsum("kl,xy->kxly", np.eye(K), np.eye(2)).reshape(K, 2, 2 * K)
    made = plate.sigma_mm * (by_entry @ one.by_marks + itself)
    # The plate's rotation is surveyed twice, once per picture.
    surveyed = np.sqrt(2.0) * placement.moves(p + one.position) @ _root(placement.covariance)
    all_causes = np.concatenate([their_pixels, calibration, made, surveyed], axis=2)
    return np.asarray(np.sum((all_causes - all_causes.mean(axis=0)) ** 2, axis=2))


def _root(covariance: Array) -> Array:
    """Return B with B B^T = covariance, whose entries may be of very different size."""
    return ErrorSource("entries", covariance, None).root
