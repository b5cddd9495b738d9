"""A closed form of the hand-eye equation A X = X B (motions between poses), without a guess.

Throughout, `base_from_flange` (n) are a robot's poses, `flange_from_held` = X is the pose of the object held by the
flange, and `held_from_fixed` (n) is the pose of a fixed object in the frame of the held one:

    base_from_flange[i] @ flange_from_held @ held_from_fixed[i] = base_from_fixed = Z      for every i.

Eye-in-hand: the camera is held and the target stands still; eye-to-hand: the target is held and the camera stands
still. One equation serves both. Eliminating Z between two poses gives A X = X B (EQ 3.192 of the thesis) with
A = inv(base_from_flange[j]) @ base_from_flange[i] and B = held_from_fixed[j] @ inv(held_from_fixed[i]).
"""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.errors import DegenerateGeometry, TooFewPoints
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_PAIRS = 20_000  # beyond about 200 poses a regular subset of the pairs is as good as all
_HALF_TURN = np.radians(172.0)  # above it the axis of a noisy rotation may be reversed
_RANK = 1e-9


def pairs(n: int) -> tuple[Longs, Longs]:
    """Return the indices (i, j), i < j, of all pairs of n poses, or of a regular part of them if they are very many."""
    i, j = np.triu_indices(n, 1)
    step = -(-len(i) // _PAIRS)
    return i[::step], j[::step]


def motions(base_from_flange: Rigid, held_from_fixed: Rigid) -> tuple[Rigid, Rigid]:
    """Return the batches A (flange j from flange i) and B (held j from held i) of all pairs: A X = X B."""
    i, j = pairs(len(base_from_flange.rotation))
    A = base_from_flange[j].inv @ base_from_flange[i]
    B = held_from_fixed[j] @ held_from_fixed[i].inv
    return A, B


def park_martin(A: Rigid, B: Rigid) -> Rigid:
    """Return X of A X = X B: the rotation that best turns the motions' rotation vectors into each other.

    log R_A = R log R_B in least squares (Park and Martin, IEEE T-RA 1994), solved as an orthogonal Procrustes problem;
    then the translation. Motions near half a turn, where noise may reverse the axis, are left out unless they are all
    there is. Raises `DegenerateGeometry` where all axes are parallel.
    """
    m = len(A.rotation)
    if m < 2:
        raise TooFewPoints("hand-eye calibration", m, 2, of="motions between poses")
    a, b = so3.log(A.rotation), so3.log(B.rotation)
    safe = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)) < _HALF_TURN
    R = procrustes(a, b, safe.astype(np.float64) if np.count_nonzero(safe) >= 2 else np.ones(m))
    return Rigid(R, _translation(A, B, R))


def procrustes(a: Array, b: Array, weights: Array) -> Array:
    """Return the rotation R with a = R b in least squares for vectors (m, 3); parallel ones are refused."""
    M = np.einsum("k,ki,kj->ij", weights, a, b)
    U, s, Vt = np.linalg.svd(M)
    if not s[1] > _RANK * s[0]:
        raise DegenerateGeometry(_PARALLEL)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def fixed_in_base(base_from_flange: Rigid, flange_from_held: Rigid, held_from_fixed: Rigid) -> Rigid:
    """Return base_from_fixed as the mean of what the poses say, the rotation in the chordal sense."""
    every = base_from_flange @ flange_from_held @ held_from_fixed
    return Rigid(so3.nearest(every.rotation.mean(axis=0)), every.translation.mean(axis=0))


_PARALLEL = (
    "the robot's motions have parallel axes (or no rotation at all): what the flange holds can slide along that axis "
    "without any observation changing; add poses that turn about two other axes, by 30 deg or more"
)


def _translation(A: Rigid, B: Rigid, R: Array) -> Array:
    """Solve (R_A - I) t = R t_B - t_A, EQ 3.196, over all motions."""
    M = A.rotation - np.eye(3)
    right = B.translation @ R.T - A.translation
    t, _, rank, _ = np.linalg.lstsq(M.reshape(-1, 3), right.ravel(), rcond=_RANK)
    if rank < 3:
        raise DegenerateGeometry(_PARALLEL)
    return np.asarray(t)
