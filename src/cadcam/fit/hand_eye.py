"""Closed forms of the hand-eye equations A X = X B (motions between poses) and R X = Z S (poses), without a guess.

Throughout, `base_from_flange` (n) are a robot's poses, `flange_from_held` = X is the pose of the object held by the
flange, and `held_from_fixed` (n) is the pose of a fixed object in the frame of the held one:

    base_from_flange[i] @ flange_from_held @ held_from_fixed[i] = base_from_fixed = Z      for every i.

Eye-in-hand: the camera is held and the target stands still; eye-to-hand: the target is held and the camera stands
still. One equation serves both. Eliminating Z between two poses gives A X = X B (EQ 3.192 of the thesis) with
A = inv(base_from_flange[j]) @ base_from_flange[i] and B = held_from_fixed[j] @ inv(held_from_fixed[i]).

Weights are one positive number per motion or pose, the inverse of its variance up to a common factor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.errors import DegenerateGeometry, TooFewPoints
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid

_PAIRS = 20_000  # beyond about 200 poses a regular subset of the pairs is as good as all
_HALF_TURN = np.radians(172.0)  # above it the axis of a noisy rotation may be reversed
_RANK = 1e-9
_TOLD = 1e-3  # second singular value over the first, of motions that determine a rotation: 2 deg between their axes
_EXACT, _AS_GOOD, _APART = 1e-7, 4.0, 0.05  # rad; ratio of costs of rotations that do equally well; and different ones
_STEPS = 4
# the 24 turns of a cube, as quaternions: none of SO(3) is farther than 63 deg from one
_STARTS = np.array(
    [q for q in product((-1, 0, 1), repeat=4) if sum(map(abs, q)) in (1, 2, 4) and next(x for x in q if x) > 0]
)
_HALF_TURNS = np.stack([np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])])


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


def tsai_lenz(A: Rigid, B: Rigid, *, weights: Array | None = None) -> Rigid:
    """Return X of A X = X B: the rotation from the motions' axes, then the translation (EQ 3.199, then EQ 3.196).

    With p = 2 sin(angle/2) axis, p_A = R p_B and the Gibbs vector g of R: (p_A + p_B) x g = p_B - p_A, linear in g
    (Tsai and Lenz, IEEE T-RA 1989). A Gibbs vector is infinite for half a turn: B is turned beforehand by each half
    turn about an axis and the smallest g is taken, which removes the singularity. Raises `DegenerateGeometry` where all
    axes are parallel.
    """
    w = _weights(A, weights)
    p_A, p_B = _modified_rodrigues(A), _modified_rodrigues(B)
    found = []
    for turn in _HALF_TURNS:
        p = p_B @ turn.T
        M = so3.hat(p_A + p) * w[:, None, None]
        g, _, rank, _ = np.linalg.lstsq(M.reshape(-1, 3), ((p - p_A) * w[:, None]).ravel(), rcond=_RANK)
        found.append((np.linalg.norm(g) if rank == 3 else np.inf, g, turn))
    size, g, turn = min(found, key=lambda f: float(f[0]))
    if not np.isfinite(size):
        raise DegenerateGeometry(_PARALLEL)
    G = so3.hat(g)
    R = so3.nearest(np.linalg.solve(np.eye(3) - G, np.eye(3) + G)) @ turn
    return Rigid(R, _translation(A, B, R, w))


def park_martin(A: Rigid, B: Rigid, *, weights: Array | None = None) -> Rigid:
    """Return X of A X = X B: the rotation that best turns the motions' rotation vectors into each other.

    log R_A = R log R_B in least squares (Park and Martin, IEEE T-RA 1994), solved as an orthogonal Procrustes problem;
    then the translation. Of several rotations that do equally well, see `rotations`, the one whose translation fits
    best is taken. Raises `DegenerateGeometry` where all axes are parallel.
    """
    w = _weights(A, weights)
    found = [_translated(A, B, turned.R, w) for turned in rotations(A, B, w**2)]
    return min(found, key=lambda X: _misfit(A, B, X, w))


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """A rotation R (3, 3) with a = R b for rotation vectors a, b (m, 3) of motions.

    Where noise may have reversed an axis, near half a turn, b goes the other way round if that is nearer to a.
    """

    R: Array
    a: Array
    b: Array

    @property
    def left(self) -> Array:
        """Return the lengths (m,) rad of what the rotation leaves between the rotation vectors."""
        return np.asarray(np.linalg.norm(self.a - self.b @ self.R.T, axis=1))


def rotations(A: Rigid, B: Rigid, weights: Array) -> list[Turned]:
    """Return the rotations that best turn the vectors of B's rotations into those of A's, weighted (m,).

    Motions near half a turn are left out where the others determine the rotation: then it is one. Else each of them
    counts either way round, and there may be several: half turns about perpendicular axes, and turns about a third, do
    not change if what is held is turned by half about one of these. Raises `DegenerateGeometry` where all axes are
    parallel.
    """
    a, b = so3.log(A.rotation), so3.log(B.rotation)
    near = np.maximum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)) >= _HALF_TURN
    s = np.linalg.svd(np.einsum("k,ki,kj->ij", weights * ~near, a, b), compute_uv=False)
    if not near.any() or s[1] > _TOLD * s[0]:
        return [Turned(procrustes(a, b, weights * ~near), a, b)]
    tried = [(float(weights @ one.left**2), one) for one in _either_way(a, b, near, weights)]
    if not tried:
        raise DegenerateGeometry(_PARALLEL)
    least = max(min(cost for cost, _ in tried), float(weights.sum()) * _EXACT**2)
    out: list[Turned] = []
    for cost, one in tried:
        if cost <= _AS_GOOD * least and all(np.linalg.norm(one.R - o.R) > _APART for o in out):
            out.append(one)
    return out


def _either_way(a: Array, b: Array, near: Mask, weights: Array) -> Iterator[Turned]:
    """Yield the rotations that are reached from starts everywhere, if vectors b that are `near` may be reversed."""
    length = np.linalg.norm(b, axis=1, keepdims=True)
    other = b * (1 - 2 * np.pi / np.where(length > 0, length, 1.0))  # the same rotation, the other way round
    for R in so3.from_quaternion(_STARTS):
        either = b
        try:
            for _ in range(_STEPS):
                back = near & (np.sum(a * (b @ R.T), axis=1) < 0)
                either = np.where(back[:, None], other, b)
                R = procrustes(a, either, weights)
        except DegenerateGeometry:  # reversed like this, their axes are parallel
            continue
        yield Turned(R, a, either)


def procrustes(a: Array, b: Array, weights: Array) -> Array:
    """Return the rotation R with a = R b in least squares for vectors (m, 3); parallel ones are refused."""
    M = np.einsum("k,ki,kj->ij", weights, a, b)
    U, s, Vt = np.linalg.svd(M)
    if not s[1] > _RANK * s[0]:
        raise DegenerateGeometry(_PARALLEL)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def daniilidis(A: Rigid, B: Rigid, *, weights: Array | None = None) -> Rigid:
    """Return X of A X = X B by dual quaternions: rotation and translation from one singular value decomposition.

    Of each motion's unit dual quaternion the vector parts alone are compared: the scalar parts of A and B are equal for
    any X, which is the screw congruence that `cadcam.fit.screw` tests (Daniilidis, IJRR 1999, eq. 31-35). Raises
    `DegenerateGeometry` where all axes are parallel.
    """
    w = _weights(A, weights)
    a, a_dual = _dual_quaternion(A)
    b, b_dual = _dual_quaternion(B)
    scale = max(float(np.abs(a_dual).max()), 1e-300)  # mm against 1
    T = np.zeros((len(a), 6, 8))
    T[:, :3, 0], T[:, :3, 1:4] = (a - b)[:, 1:], so3.hat((a + b)[:, 1:])
    T[:, 3:, 0], T[:, 3:, 1:4] = (a_dual - b_dual)[:, 1:] / scale, so3.hat((a_dual + b_dual)[:, 1:]) / scale
    T[:, 3:, 4], T[:, 3:, 5:] = T[:, :3, 0], T[:, :3, 1:4]
    _, s, Vt = np.linalg.svd((T * w[:, None, None]).reshape(-1, 8), full_matrices=False)
    if not s[5] > _RANK * s[0]:
        raise DegenerateGeometry(_PARALLEL)
    q, q_dual = _unit_combination(Vt[6], Vt[7])
    t = 2 * scale * _quaternion_product(q_dual, q * [1, -1, -1, -1])[1:]
    return Rigid(so3.from_quaternion(q), t)


def kronecker(base_from_flange: Rigid, held_from_fixed: Rigid) -> tuple[Rigid, Rigid]:
    """Return (flange_from_held, base_from_fixed) of the poses themselves, without pairs.

    The rotations maximise sum tr(R_Z' R_i R_X S_i), by the leading singular vectors of sum S_i' (x) R_i (Shah, J.
    Mechanisms Robotics 2013); both translations then follow from one linear system. Raises `DegenerateGeometry` where
    the motions leave rotation or translation open.
    """
    R, S = base_from_flange.rotation, held_from_fixed.rotation
    n = len(R)
    if n < 3:
        raise TooFewPoints("hand-eye calibration", n, 3, of="poses")
    K = np.einsum("nij,nkl->iljk", R, S).reshape(9, 9)  # R_Z[i,l] R_i[i,j] X[j,k] S_i[k,l]
    U, s, Vt = np.linalg.svd(K)
    if not s[1] < (1 - _RANK) * s[0]:
        raise DegenerateGeometry(_PARALLEL)
    X, Z = (so3.nearest(M * np.cbrt(1 / np.linalg.det(M))) for M in (Vt[0].reshape(3, 3), U[:, 0].reshape(3, 3)))
    M = np.concatenate([R, np.broadcast_to(-np.eye(3), R.shape)], axis=-1).reshape(-1, 6)
    right = -(base_from_flange.translation + (R @ (X @ held_from_fixed.translation[..., None]))[..., 0])
    t, _, rank, _ = np.linalg.lstsq(M, right.ravel(), rcond=_RANK)
    if rank < 6:
        raise DegenerateGeometry(_PARALLEL)
    return Rigid(X, t[:3]), Rigid(Z, t[3:])


def fixed_in_base(base_from_flange: Rigid, flange_from_held: Rigid, held_from_fixed: Rigid) -> Rigid:
    """Return base_from_fixed as the mean of what the poses say, the rotation in the chordal sense."""
    every = base_from_flange @ flange_from_held @ held_from_fixed
    return Rigid(so3.nearest(every.rotation.mean(axis=0)), every.translation.mean(axis=0))


_PARALLEL = (
    "the robot's motions have parallel axes (or no rotation at all): what the flange holds can slide along that axis "
    "without any observation changing; add poses that turn about two other axes, by 30 deg or more"
)


def _weights(A: Rigid, weights: Array | None) -> Array:
    """Square roots of the weights, which multiply residuals."""
    m = len(A.rotation)
    if m < 2:
        raise TooFewPoints("hand-eye calibration", m, 2, of="motions between poses")
    return np.ones(m) if weights is None else np.sqrt(np.asarray(weights, dtype=np.float64))


def _modified_rodrigues(T: Rigid) -> Array:
    w = so3.log(T.rotation)
    angle = np.linalg.norm(w, axis=1, keepdims=True)
    return np.asarray(w * np.sinc(angle / (2 * np.pi)))  # 2 sin(angle/2) axis


def _translated(A: Rigid, B: Rigid, R: Array, w: Array) -> Rigid:
    return Rigid(R, _translation(A, B, R, w))


def _misfit(A: Rigid, B: Rigid, X: Rigid, w: Array) -> float:
    """Return the weighted sum of squares, mm^2, by which the translations of A X and X B differ."""
    apart = (A @ X).translation - (X @ B).translation
    return float(np.sum((w[:, None] * apart) ** 2))


def _translation(A: Rigid, B: Rigid, R: Array, w: Array) -> Array:
    """Solve (R_A - I) t = R t_B - t_A, EQ 3.196, over all motions."""
    M = (A.rotation - np.eye(3)) * w[:, None, None]
    right = (B.translation @ R.T - A.translation) * w[:, None]
    t, _, rank, _ = np.linalg.lstsq(M.reshape(-1, 3), right.ravel(), rcond=_RANK)
    if rank < 3:
        raise DegenerateGeometry(_PARALLEL)
    return np.asarray(t)


def _dual_quaternion(T: Rigid) -> tuple[Array, Array]:
    q = so3.quaternion(T.rotation)
    t = np.concatenate([np.zeros((len(q), 1)), T.translation], axis=1)
    return q, 0.5 * _quaternion_product(t, q)


def _quaternion_product(p: Array, q: Array) -> Array:
    w = p[..., :1] * q[..., :1] - np.sum(p[..., 1:] * q[..., 1:], axis=-1, keepdims=True)
    v = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    return np.concatenate([w, v], axis=-1)


def _unit_combination(v: Array, w: Array) -> tuple[Array, Array]:
    """Return (q, q') = l v + m w with |q| = 1 and q.q' = 0; of two solutions that of the larger |q| before scaling."""
    a, b, c = v[:4] @ v[4:], v[:4] @ w[4:] + w[:4] @ v[4:], w[:4] @ w[4:]
    root = float(np.sqrt(np.maximum(b * b - 4 * a * c, 0.0)))
    half = -0.5 * (b + (root if b >= 0 else -root))  # roots (l : m) without cancellation
    candidates = [np.array([half, a]), np.array([c, half])]
    best = max(candidates, key=lambda k: _share(k, v, w))
    both = best[0] * v + best[1] * w
    both = both / np.linalg.norm(both[:4])
    return both[:4], both[4:]


def _share(k: Array, v: Array, w: Array) -> float:
    """Return |q|^2 of the normalised combination; -1 where there is none."""
    size = float(np.linalg.norm(k))
    return float(np.sum((k[0] * v[:4] + k[1] * w[:4]) ** 2)) / size**2 if size > 0 else -1.0
