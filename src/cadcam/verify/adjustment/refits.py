"""Many fits to nearly the same edges: what an edge adds to them is found once for each common error that is tried.

The golden section tries the same common errors for all of them as long as it turns the same way, which it mostly does.
What is summed is what each fit keeps, never the whole less what it lacks: that difference would be rounding where a fit
keeps little.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.verify.adjustment.scatter import EdgeSums, likeliest


@dataclass(frozen=True, slots=True, eq=False)
class Normals:
    """(J F)^T V^-1 (J F, y, C) of each edge (E, k, k + 1 + r), which are independent of each other.

    kept (E,): edges that a fit takes whole; of those that it takes in part, the numbers `in_part` (p,) and what that
    part gives, `part` (p, k, k + 1 + r).
    """

    each: Array
    kept: Mask
    in_part: Longs
    part: Array

    @classmethod
    def of(cls, each: Array) -> Normals:
        """Return those of a fit to all of the edges."""
        return cls(each, np.ones(len(each), bool), np.zeros(0, np.int64), each[:0])

    def total(self, without: Longs | None = None) -> Array:
        """Return their sum (k, k + 1 + r), without the edges of these numbers."""
        kept, part = self.kept, self.part
        if without is not None:
            gone = np.zeros(len(kept), bool)
            gone[without] = True
            kept, part = kept & ~gone, part[~gone[self.in_part]]
        whole = kept.astype(np.float64) @ self.each.reshape(len(kept), -1)
        return np.asarray(whole.reshape(self.each.shape[1:]) + part.sum(axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class Refits:
    """The sums over E edges that fits are made to, the errors (E,) px known of each, and what was tried before.

    with_cameras: the sums that the common error follows from, of which the first `sums.fitted` are unknown.
    """

    sums: EdgeSums
    with_cameras: EdgeSums
    known: Array
    terms: dict[float, tuple[Array, Array]] = field(default_factory=dict)
    normals: dict[float, Array] = field(default_factory=dict)

    def common_error(self, kept: Mask, in_part: Longs, part: EdgeSums, *, usual: float | None) -> float:
        """Return tau (px) of a fit to the edges `kept` (E,) and those `in_part` (p,), of which it has the sums `part`.

        Those with the errors of cameras; see `cadcam.verify.adjustment.scatter.common_error`.
        """
        whole, known, sums = kept.astype(np.float64), self.known[in_part], self.with_cameras
        noise = float(whole @ sums.log_noise + part.log_noise.sum())

        def terms(log_tau: float) -> tuple[Array, float]:
            if log_tau not in self.terms:
                self.terms[log_tau] = sums.terms(self.known, log_tau)
            each, inner = self.terms[log_tau]
            total, log_det = whole @ each, noise + float(whole @ inner)
            if len(in_part):
                each, inner = part.terms(known, log_tau)
                total, log_det = total + each.sum(axis=0), log_det + float(inner.sum())
            return total, log_det

        return likeliest(terms, sums.fitted, usual=usual, free=self.sums.fitted)

    def fitted(self, kept: Mask, in_part: Longs, part: EdgeSums, tau: float) -> Normals:
        """Return the normal equations of such a fit for the common error tau (px)."""
        if tau not in self.normals:
            self.normals[tau] = self.sums.normal(np.hypot(self.known, tau))
        return Normals(self.normals[tau], kept, in_part, part.normal(np.hypot(self.known[in_part], tau)))
