"""How significant an alarm must be when many are possible."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Floats, Mask

AS_IN_PLACE = 0.05  # probability, for a feature in place, from which its edges are no evidence of a displacement
_SINGULAR = 1e-12  # of the largest variance: a direction without information of its own


def false_discoveries_below(p_values: Floats, share: float) -> Mask:
    """Return which of the hypotheses (n,) are rejected so that at most `share` of these, on average, are true.

    Y. Benjamini and Y. Hochberg, J. R. Stat. Soc. B 57 (1995). Where all of them are true, the probability of rejecting
    any is at most `share`: a picture without a fault raises an alarm in at most that share of pictures. nan: not
    tested.
    """
    p = np.asarray(p_values, np.float64)
    tested = np.flatnonzero(np.isfinite(p))
    order = tested[np.argsort(p[tested])]
    below = p[order] <= share * np.arange(1, len(order) + 1) / max(len(order), 1)
    out = np.zeros(len(p), bool)
    if below.any():
        out[order[: int(np.flatnonzero(below)[-1]) + 1]] = True
    return out


def surely_below(p_values: Floats, share: float) -> Mask:
    """Return which of the hypotheses (n,) are rejected so that, whichever are true, one is in at most `share` of cases.

    S. Holm, Scand. J. Stat. 6 (1979). nan: not tested.
    """
    p = np.asarray(p_values, np.float64)
    tested = np.flatnonzero(np.isfinite(p))
    order = tested[np.argsort(p[tested])]
    above = p[order] > share / np.arange(len(order), 0, -1)
    out = np.zeros(len(p), bool)
    out[order[: int(np.argmax(above)) if above.any() else len(order)]] = True
    return out


def tail_probability(value: Array, covariance: Array, dof: float) -> float:
    """Return the probability of a value (m,) this large where the truth is zero, its covariance known to `dof` degrees.

    Hotelling's statistic, with the F(m, dof) distribution: with few edges, its tails are wide.
    """
    from scipy.special import chdtrc, fdtrc  # wrapped by scipy.stats, which takes half a second to import

    if not len(value):
        return float("nan")
    w, V = np.linalg.eigh(covariance)
    known = w > _SINGULAR * max(float(w[-1]), 0.0)
    m = int(known.sum())
    if m == 0:
        return float("nan")
    statistic = float((((V[:, known].T @ value) ** 2) / w[known]).sum())
    if not np.isfinite(dof):
        return float(chdtrc(m, statistic))
    return float(fdtrc(m, max(dof, 1.0), statistic / m))


def either(p: float, other: float) -> float:
    """Return the probability that counts of two tests of the same edges: `other` only where p is evidence by itself.

    p, or twice the other's where that is less. Of edges in place, independent tests fall below a in 1.025 a of cases,
    a up to `AS_IN_PLACE`; in 1.5 a at the very most, if never both did.
    """
    return min(p, 2 * other) if p <= AS_IN_PLACE else p
