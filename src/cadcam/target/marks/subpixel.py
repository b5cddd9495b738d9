"""Sub-pixel positions from a correlation peak or from grey values: the dissertation's chapter 4, and the usual ones.

The dissertation's method: the autocorrelation of a rotation-symmetric template is described by

    f(x, y) = exp(-a ((x/l)^2 + (y/l)^2)^(p/2)),                                        (EQ 4.2)

and f(x + dx, y + dy) is shifted until it fits the correlation of template and picture best, in the root mean square of
EQ 4.5 (printed without its root). The position is then at -(dx, dy): Tables 4.2 and 4.3 print (dx, dy), Table 4.1 has
the position's signs. It requires the zero-mean correlation: with means kept (EQ 7.1) nothing falls to exp(-8). The fit
of the grey values themselves in `target.marks.fit` is better in every respect but simplicity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Floats, Picture
from cadcam.errors import BadValue
from cadcam.target.marks.cross import correlation_at, taps

_REACH = 1.0  # px: largest shift of the function
_WINDOW = 1.35  # radii: window of the centroid
_ROUNDS = 5  # times that the window follows the centroid


@dataclass(frozen=True, slots=True)
class Peak:
    """f(x, y) = exp(-a (r/l)^p) (EQ 4.2); l: half-width of the window, px. rms: of the fit to an autocorrelation."""

    a: float
    p: float
    l: int
    rms: float | None = None

    def __call__(self, x: Floats, y: Floats) -> Array:
        """Return f at x, y px from the centre."""
        r = np.hypot(np.asarray(x, np.float64), np.asarray(y, np.float64)) / self.l
        return np.asarray(np.exp(-self.a * r**self.p))

    @classmethod
    def of_template(cls, picture: Picture) -> Peak:
        """Return the function that fits a template's zero-mean autocorrelation best, within l px along both axes.

        That is as far as the autocorrelation falls, before it rises again (the "ringing").
        """
        surface = autocorrelation(picture)
        middle = surface.shape[0] // 2
        rises = np.flatnonzero(np.diff(surface[middle, middle:]) >= 0)
        l = int(rises[0]) if rises.size else middle
        if l < 1:
            raise BadValue("template", "with an autocorrelation that does not fall", "one of a mark")
        window = surface[middle - l : middle + l + 1, middle - l : middle + l + 1]
        return cls._fitted(window, l)

    @classmethod
    def _fitted(cls, window: Array, l: int) -> Peak:
        from scipy.optimize import least_squares

        y, x = np.mgrid[-l : l + 1, -l : l + 1]

        def residuals(parameters: Array) -> Array:
            return np.asarray(
                (cls(float(np.exp(parameters[0])), float(np.exp(parameters[1])), l)(x, y) - window).ravel()
            )

        best = least_squares(residuals, np.log([4.0, 1.5]))
        a, p = np.exp(best.x).tolist()
        return cls(a, p, l, float(np.sqrt(np.mean(best.fun**2))))

    def rms_at(self, window: Array, shift: Floats) -> float:
        """Return the root mean square of EQ 4.5 between a window (2l+1, 2l+1) and f(x + dx, y + dy)."""
        dx, dy = np.asarray(shift, np.float64)
        y, x = np.mgrid[-self.l : self.l + 1, -self.l : self.l + 1]
        return float(np.sqrt(np.mean((self(x + dx, y + dy) - window) ** 2)))

    def shift(self, window: Array, *, grid: float | None = None) -> tuple[Array, float]:
        """Return the (dx, dy) of EQ 4.4 with the least rms, and that rms; the mark is at -(dx, dy) from the pixel.

        window (2l+1, 2l+1): correlations about their highest pixel. grid: step in px of a grid search as in the
        dissertation (0.02); None: the continuous minimum. Within one pixel in all directions.
        """
        window = np.asarray(window, np.float64)
        if window.shape != (2 * self.l + 1,) * 2:
            raise BadValue("window", f"of shape {window.shape}", f"({2 * self.l + 1}, {2 * self.l + 1})")
        if grid is not None:
            return self._on_grid(window, grid)
        from scipy.optimize import least_squares

        y, x = np.mgrid[-self.l : self.l + 1, -self.l : self.l + 1]

        def residuals(d: Array) -> Array:
            return np.asarray((self(x + d[0], y + d[1]) - window).ravel())

        start, _ = self._on_grid(window, 0.2)
        start = start.clip(-0.99 * _REACH, 0.99 * _REACH)
        bounds = (np.minimum(start, -_REACH) - 1e-9, np.maximum(start, _REACH) + 1e-9)
        best = least_squares(residuals, start + 1e-3, bounds=bounds, xtol=1e-10, ftol=1e-12)
        return np.asarray(best.x), float(np.sqrt(np.mean(best.fun**2)))

    def _on_grid(self, window: Array, grid: float) -> tuple[Array, float]:
        if not 0 < grid <= 1:
            raise BadValue("grid", grid, "a step in px, at most 1")
        whole = round(_REACH / grid)
        rough = max(1, whole // 10)
        middle = self._best_step(window, grid, np.zeros(2, int), whole // rough * rough, rough)
        best = self._best_step(window, grid, middle, rough, 1)
        where = best * grid
        return where, self.rms_at(window, where)

    def _best_step(self, window: Array, grid: float, about: Array, reach: int, every: int) -> Array:
        """Return the steps (2,), whole numbers, with the least sum of squares, `every` apart within `reach`."""
        y, x = np.mgrid[-self.l : self.l + 1, -self.l : self.l + 1]
        steps = np.arange(-reach, reach + 1, every)
        dx, dy = (a.ravel() for a in np.meshgrid(about[0] + steps, about[1] + steps))
        f = self(x + grid * dx[:, None, None], y + grid * dy[:, None, None])
        k = int(np.argmin(np.mean((f - window) ** 2, axis=(1, 2))))
        return np.array([dx[k], dy[k]])


def autocorrelation(picture: Picture, *, zero_mean: bool = True) -> Array:
    """Return the normalised correlation (n, n) of a template (n, n) with itself on plain ground, by shift in px."""
    n = picture.shape[0]
    half = n // 2
    ground = np.pad(picture, n, mode="edge")
    dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
    middle = n + half
    of = taps(picture, circular=False)
    return correlation_at(ground, (middle + dx).ravel(), (middle + dy).ravel(), of, zero_mean=zero_mean).reshape(n, n)


def parabola(window: Floats) -> Array:
    """Return the maximum (..., 2) of the quadric a + b.q + q.C q fitted to values (..., 3, 3), px from the middle.

    The least squares quadric with its six terms; NaN for a stationary point that is no maximum or over a pixel away.
    """
    z = np.asarray(window, np.float64)
    if z.shape[-2:] != (3, 3):
        raise BadValue("window", f"of shape {z.shape}", "(..., 3, 3)")
    x, y = np.array([-1.0, 0.0, 1.0]), np.array([[-1.0], [0.0], [1.0]])
    bx, by = (z * x).sum(axis=(-2, -1)) / 6, (z * y).sum(axis=(-2, -1)) / 6
    xx, yy = ((z * (3 * t * t - 2)).sum(axis=(-2, -1)) / 3 for t in (x, y))  # second derivatives
    xy = (z * x * y).sum(axis=(-2, -1)) / 4
    det = xx * yy - xy * xy
    with np.errstate(all="ignore"):
        q = np.stack([(xy * by - yy * bx) / det, (xy * bx - xx * by) / det], axis=-1)
    summit = (det > 0) & (xx < 0) & (np.abs(q) <= 1).all(axis=-1)
    return np.asarray(np.where(summit[..., None], q, np.nan))


def centroid(gray: Picture, q: Floats, radius: float) -> Array:
    """Return the centroid (2,) of the grey values' distance from the ground, within a window about q that follows it.

    The ground is the median on the window's rim; radius: of the mark, px. Only for isolated marks on plain ground:
    other structure, noise in the window and varying light all bias it.
    """
    at = np.asarray(q, np.float64).copy()
    half = int(np.ceil(_WINDOW * radius)) + 1
    for _ in range(_ROUNDS):
        x0, y0 = (int(v) for v in np.rint(at))
        left, top = max(x0 - half, 0), max(y0 - half, 0)
        part = gray[top : y0 + half + 1, left : x0 + half + 1].astype(np.float64)
        if part.size == 0:
            return np.full(2, np.nan)
        y, x = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
        r = np.hypot(x - at[0], y - at[1])
        inside, rim = (_WINDOW * radius + 0.5 - r).clip(0, 1), np.abs(r - _WINDOW * radius) <= 1
        weight = (part - np.median(part[rim])) * inside if rim.any() else inside
        total = weight.sum()
        if abs(total) < 1e-9:
            return np.full(2, np.nan)
        at = np.array([(weight * x).sum(), (weight * y).sum()]) / total
        if not np.isfinite(at).all() or np.abs(at - q).max() > 2 * radius:
            return np.full(2, np.nan)
    return at
