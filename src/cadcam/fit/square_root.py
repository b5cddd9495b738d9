"""The information of a block problem at its minimum: rank, undetermined directions by name, and covariances.

One QR factorisation of [own | shared | residual] per block gives a triangle whose lower part holds the block's
information on the shared parameters alone. Nothing is squared: singular values down to 1e-10 of the columns' length
count. Source of the jackknife by blocks: MacKinnon and White (1985), Bell and McCaffrey (2002).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import DegenerateGeometry, TooFewPoints
from cadcam.fit.least_squares import combination
from cadcam.fit.schur import Blocks

_RANK = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Cofactors:
    """Covariances for residuals of unit noise, and what each block contributes.

    shared (n, n); own (k, l, l); lever (k, l, n): own parameters change by -lever @ d(shared) with the shared ones;
    own_alone (k, l, l): their cofactor with the shared ones fixed. scores (k, n): the gradient of each block by the
    shared parameters, its own parameters re-fitted; they sum to zero. information (k, n, n): that of each block on the
    shared parameters.
    """

    shared: Array
    own: Array
    own_alone: Array
    lever: Array
    scores: Array
    information: Array

    def cross(self, block: int) -> Array:
        """Return the cofactor (n, l) between the shared parameters and those of one block."""
        return np.asarray(-self.shared @ self.lever[block].T)

    def between(self, one: int, other: int) -> Array:
        """Return the cofactor (l, l) between the parameters of two different blocks."""
        return np.asarray(self.lever[one] @ self.shared @ self.lever[other].T)

    def jackknifed(self) -> Array:
        """Return the covariance (n, n) by leaving out one block at a time, each by one exact linear step.

        (k - 1)/k sum_j d_j d_j^T with d_j = (N - N_j)^-1 c_j. It holds though errors be alike within a block and their
        size be unknown, and is never too small on average. Raises `TooFewPoints` for less than two blocks, and
        `DegenerateGeometry` if the shared parameters are not determined without one of them.
        """
        k = len(self.scores)
        if k < 2:
            raise TooFewPoints("a covariance by blocks", k, 2, of="blocks")
        d = np.sqrt(np.diagonal(self.shared))
        left = np.linalg.inv(self.shared / np.outer(d, d)) - self.information * np.outer(d, d)
        values = np.linalg.eigvalsh(left)[:, 0] if d.size else np.ones(k)
        if (values <= _RANK).any():
            raise DegenerateGeometry(
                f"block {int(np.argmin(values)) + 1} of {k} cannot be left out: the others do not determine the shared "
                "parameters; add views"
            )
        moves = np.linalg.solve(left, (self.scores * d)[..., None])[..., 0] * d
        return np.asarray(moves.T @ moves * ((k - 1) / k))


def factorise(
    blocks: Blocks,
    shared_names: Sequence[str],
    own_names: Sequence[str],
    block_names: Sequence[str] | None = None,
    *,
    kind: str = "block",
) -> Cofactors:
    """Return the cofactors of (weighted) blocks at a minimum; `kind` is the name of a block in messages.

    Raises `DegenerateGeometry` naming the combination of parameters that the residuals do not determine: of one block
    with the shared parameters fixed, or of the shared parameters with every block's own free.
    """
    k, n, own = blocks.sizes
    labels = [f"{kind} {name}" for name in (range(1, k + 1) if block_names is None else block_names)]
    scale, own_scale = _lengths(blocks)
    R = _triangles(blocks, scale, own_scale)
    bb, ba, aa, ar = R[:, :own, :own], R[:, :own, own : own + n], R[:, own:-1, own:-1], R[:, own:-1, -1]
    _refuse_blind_blocks(bb, own_scale, own_names, labels)
    inverse = np.linalg.inv(bb) if own else bb
    enough = np.zeros((n, n))  # at least n rows, so that Vt is complete
    rows = np.concatenate([aa.reshape(k * n, n), blocks.alone / scale, enough])
    _, s, Vt = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    _refuse_blind(s, Vt, scale, shared_names, kind)
    W = (Vt.T / s) / scale[:, None]
    lever = (inverse @ ba) / own_scale[:, :, None] * scale
    alone = inverse / own_scale[:, :, None]
    shared = W @ W.T
    own_alone = alone @ np.swapaxes(alone, -1, -2)
    return Cofactors(
        shared=shared,
        own=own_alone + lever @ shared @ np.swapaxes(lever, -1, -2),
        own_alone=own_alone,
        lever=lever,
        scores=(np.swapaxes(aa, -1, -2) @ ar[..., None])[..., 0] * scale,
        information=(np.swapaxes(aa, -1, -2) @ aa) * np.outer(scale, scale),
    )


def _triangles(blocks: Blocks, scale: Array, own_scale: Array) -> Array:
    """Return R (k, l + n + 1, l + n + 1) of [own | shared | residual] per block, columns scaled.

    Scaled afterwards, which is equivalent to rounding: a column's length does not change the reflections.
    """
    stacked = blocks.stacked
    k, width, rows = stacked.shape
    if rows < width:
        stacked = np.concatenate([stacked, np.zeros((k, width, width - rows))], axis=2)
    R: Array = np.asarray(np.linalg.qr(np.swapaxes(stacked, 1, 2), mode="r"))
    R[..., : blocks.own] /= own_scale[:, None, :]
    R[..., blocks.own : -1] /= scale
    return R


def _refuse_blind_blocks(bb: Array, own_scale: Array, names: Sequence[str], labels: Sequence[str]) -> None:
    if not bb.shape[-1]:
        return
    s = np.linalg.svd(bb, compute_uv=False)
    ratio = s[:, -1] / np.where(s[:, 0] > 0, s[:, 0], 1.0)
    worst = int(np.argmin(ratio))
    if ratio[worst] <= _RANK:
        v = np.linalg.svd(bb[worst])[2][-1]
        raise DegenerateGeometry(
            f"{labels[worst]} does not determine {combination(v, v / own_scale[worst], names)} "
            f"(singular value ratio {ratio[worst]:.2g}) even if all shared parameters are held; it has too few points, "
            "or they lie on a line: add points to it or leave it out"
        )


def _refuse_blind(s: Array, Vt: Array, scale: Array, names: Sequence[str], kind: str) -> None:
    if not len(s) or s[-1] > _RANK:
        return
    raise DegenerateGeometry(
        f"the observations do not determine {combination(Vt[-1], Vt[-1] / scale, names)} (singular value {s[-1]:.2g} "
        f"of columns of length one, every {kind} free to follow); fix one of these parameters, or add {kind}s that "
        "tell them apart"
    )


def _lengths(blocks: Blocks) -> tuple[Array, Array]:
    """Return the lengths of the shared columns (n,) and of each block's own (k, l), 1 for a column of zeros."""
    squares = np.einsum("kcm,kcm->kc", blocks.stacked, blocks.stacked)
    shared = squares[:, blocks.own : -1].sum(axis=0) + np.sum(blocks.alone**2, axis=0)
    own = squares[:, : blocks.own]
    return np.sqrt(np.where(shared > 0, shared, 1.0)), np.sqrt(np.where(own > 0, own, 1.0))
