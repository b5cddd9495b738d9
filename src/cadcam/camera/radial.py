"""Radial curves of lenses: their turning points, and their inverse. Shared by the lens models."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

from cadcam.arrays import Array, Mask, component_major

_ITERATIONS = 60  # bisection alone halves the bracket this often: below one ulp
_DONE = 8 * np.finfo(np.float64).eps  # smaller steps are rounding, which may oscillate for ever
_NOTHING = 1e-150  # of the largest coefficient: by less a companion matrix cannot be divided
_LAST = 1e-9  # after a Newton step this small the error is its square


def polynomial_limit(odd: Sequence[float]) -> float:
    """Return the smallest r > 0 where the derivative of sum odd[k] r^(2k+1) vanishes, inf if it never does."""
    slope = [(2 * k + 1) * c for k, c in enumerate(odd)]
    return _smallest_root(slope)


def rational_limit(numerator: Sequence[float], denominator: Sequence[float]) -> float:
    """Return the smallest r > 0 where r N(r^2)/D(r^2) stops rising or its denominator vanishes.

    N = 1 + n1 s + n2 s^2 + ..., D alike, s = r^2. The derivative has the sign of N D + 2 s (N' D - N D').
    """
    N, D = Polynomial([1.0, *numerator]), Polynomial([1.0, *denominator])
    slope = N * D + 2 * Polynomial([0.0, 1.0]) * (N.deriv() * D - N * D.deriv())
    return min(_smallest_root(np.real(slope.coef)), _smallest_root(np.real(D.coef)))


def _smallest_root(in_r2: npt.ArrayLike) -> float:
    """Return sqrt of the smallest positive real root of a polynomial in s = r^2 (ascending coefficients)."""
    c = np.asarray(in_r2, dtype=np.float64)
    c = np.trim_zeros(np.where(np.abs(c) > _NOTHING * np.abs(c).max(), c, 0.0), "b")
    if c.size < 2:
        return np.inf
    roots = Polynomial(c).roots()
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(np.sqrt(real.min())) if real.size else np.inf


def fold_limit(jacobian: Callable[[Array], Array], limit: float) -> float:
    """Return the largest radius <= limit below which det(dm/du) > 0 in every direction, for lenses without symmetry.

    Scanned over 180 directions and 128 radii, the first sign change refined by bisection; the scan ends at 84 deg off
    the axis, beyond any lens of this family.
    """
    phi = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    e = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    radii = np.linspace(0, min(limit, 10.0), 129)[1:]

    def upright(u: Array) -> Mask:
        with np.errstate(all="ignore"):
            J = jacobian(u)
            return np.asarray(J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0] > 0)

    folded = ~upright(radii[:, None, None] * e).all(axis=1)
    if not folded.any():
        return limit
    outer = radii[int(np.argmax(folded))]
    inner = outer - radii[0]
    for _ in range(40):
        middle = 0.5 * (inner + outer)
        inner, outer = (middle, outer) if upright(middle * e).all() else (inner, middle)
    return float(inner)


def inverse(curve: Callable[[Array], tuple[Array, Array]], rho: Array, limit: float, *, rough: bool = False) -> Array:
    """Return r in [0, limit) with curve(r) = rho, to rounding, NaN if there is none.

    rough: only a start for `newton_plane`, to a thousandth, and just inside the limit if there is none. `curve` gives
    value and slope and increases on [0, limit), where it turns or has a pole. Newton's step where it stays in the
    bracket, else bisection.
    """
    rho = np.asarray(rho, dtype=np.float64)
    done = 1e-3 if rough else _DONE
    with np.errstate(all="ignore"):
        high = _upper_bracket(curve, rho, limit)
        end = curve(high)[0]
        pole = end < 0  # rounding has put the limit beyond a pole: up to there the curve takes every value
        reachable = (end >= rho) | (pole & (rho < np.inf))
        low, r = np.zeros_like(rho), np.minimum(rho, 0.5 * high)
        for _ in range(_ITERATIONS):
            value, slope = curve(r)
            low, high = np.where(value <= rho, r, low), np.where(value > rho, r, high)
            newton = r - (value - rho) / slope
            r_next = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
            if np.all((np.abs(r_next - r) <= done * np.abs(r)) | ~reachable | np.isnan(rho)):
                r = r_next
                break
            r = r_next
    return np.where(reachable, r, 0.999 * limit if rough else np.nan)


def _upper_bracket(curve: Callable[[Array], tuple[Array, Array]], rho: Array, limit: float) -> Array:
    if np.isfinite(limit):
        return np.full_like(rho, limit)
    high = np.ones_like(rho)  # not rho: from far beyond the root a power is left by a share of r at each Newton step
    for _ in range(60):  # a curve without a turning point increases, but perhaps slowly
        short = curve(high)[0] < rho
        if not short.any():
            break
        high = np.where(short, 2 * high, high)
    return high


def newton_plane(
    distort: Callable[[Array], Array],
    linearised: Callable[[Array, Sequence[int]], tuple[Array, Array, Array]],
    m: Array,
    start: Array,
    *,
    within: float = np.inf,
) -> Array:
    """Return u with distort(u) = m by Newton's method in the plane from `start`; NaN where it does not converge.

    linearised(u, ()) gives distort(u) and its Jacobian (..., 2, 2). No step goes farther than half the way that is left
    to the circle of radius `within`, beyond which near a fold the first steps would end on the other branch.
    """
    bounded = within < np.inf
    u, scale = _drawn_in(start, 0.0, within) if bounded else start, 1 + _larger(m)
    for _ in range(30):
        reached, J, _ = linearised(u, ())
        step = _solved(J, reached - m)
        u = _drawn_in(u - step, np.hypot(u[..., 0], u[..., 1]), within) if bounded else u - step
        size = _larger(step)
        if np.all((size <= _LAST * scale) | np.isnan(size)) and np.all(
            (size <= _LAST * (1 + _larger(u))) | np.isnan(size)  # next to a pole m is far larger than u
        ):
            break
    residual = _larger(distort(u) - m)
    rounding = np.abs(J).max(axis=(-2, -1)) * _larger(u)  # of u, which a steep lens (near a pole) amplifies
    return np.where((residual <= 1e-13 * (scale + rounding))[..., None], u, np.nan)


def _drawn_in(u: Array, before: Array | float, limit: float) -> Array:
    """Return points u that lie beyond half the way from a radius `before` to `limit`, drawn in to there."""
    r, farthest = np.hypot(u[..., 0], u[..., 1]), 0.5 * (before + limit)
    return np.where((r > farthest)[..., None], u * (farthest / np.where(r > 0, r, 1.0))[..., None], u)


def _larger(v: Array) -> Array:
    """Return max(|x|, |y|); numpy's own reduction over an axis of two is ten times slower."""
    return np.asarray(np.maximum(np.abs(v[..., 0]), np.abs(v[..., 1])))


def _solved(J: Array, b: Array) -> Array:
    """Return J^-1 b for 2x2 matrices, by Cramer's rule."""
    det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
    out = component_major(b.shape[:-1], 2)
    out[..., 0] = (J[..., 1, 1] * b[..., 0] - J[..., 0, 1] * b[..., 1]) / det
    out[..., 1] = (J[..., 0, 0] * b[..., 1] - J[..., 1, 0] * b[..., 0]) / det
    return out


def radial_jacobian(u: Array, gain: Array, slope: Array) -> Array:
    """Return d(u gain(r^2))/du (..., 2, 2) for gain and slope = dgain/dr^2."""
    return np.asarray(
        gain[..., None, None] * np.eye(2) + 2 * slope[..., None, None] * (u[..., :, None] * u[..., None, :])
    )
