"""The two tilts of a mark, and the position of its centre while the tilt is undecided.

A mark's shape allows two tilts, to opposite sides of the line of sight. Each is fitted. Where they are far apart, they
are weighted by the grey values and the prior on the plane; where a mark looks upright they merge, and the mean is taken
over all tilts in between: the misfit is known there as a quadratic form in the homography, in which the image is nearly
linear while it is far from linear in the tilt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry import rotation as so3
from cadcam.native.marks import LOOSE, picture_with_slopes
from cadcam.target.marks.fit import CameraFit, MarkFit, joined, seen_through
from cadcam.target.marks.mark import Mark
from cadcam.target.marks.model import Geometry, borders_of, posed, with_slopes
from cadcam.target.marks.occlusion import HIDDEN
from cadcam.target.marks.tilts import tilts, toward
from cadcam.target.marks.window import MARGIN, batches

NORMAL_SD = 0.1  # rad
_SURE = 500.0  # log odds that count as certain
_MERGED = 12.0  # chi-square of the upright pose below which the two tilts are not separate
_UNLIKELY = 20.0  # chi-square beyond which tilts are neglected
_STEEPEST = 1.2  # rad
_RINGS, _SPOKES, _SIDE = 14, 8, 21  # tilts sampled to find the range of the likely ones, and then within it
_SHAPE = [0, 1, 2, 3, 9, 10, 11, 12, 13]  # indices of the derivatives by the nine elements of H


def fit_both_tilts(
    gray: Picture,
    mark: Mark,
    camera: Camera,
    fit: MarkFit,
    *,
    normal: Array | None = None,
    normal_sd: float = NORMAL_SD,
    margin: float = MARGIN,
) -> MarkFit:
    """Return affine fits refined as poses through a camera, from both tilts that a mark's shape allows.

    The pose is the likelier one, the position the mean over both by their probabilities, and the covariance includes
    their distance: marks that look upright do not show which way they are tilted. normal (3,): of the plane in the
    camera frame, with a standard deviation of normal_sd rad about each axis.
    """
    if not len(fit):
        return replace(fit, poses=())
    blur = float(np.median(fit.blur))
    prior = None if normal is None else (normal, normal_sd)
    groups = batches(mark, fit.image_from_mark, margin)  # beside a large mark, small ones would get windows as large
    return joined([_both_tilts(gray, mark, camera, fit.subset(k), prior, margin, blur) for k in groups], groups)


def _both_tilts(
    gray: Picture,
    mark: Mark,
    camera: Camera,
    fit: MarkFit,
    prior: tuple[Array, float] | None,
    margin: float,
    blur: float,
) -> MarkFit:
    """Return `fit_both_tilts` of marks whose windows are of similar size; blur: a guess, px."""
    starts = [tilts(camera, q, S) for q, S in zip(fit.q, fit.image_from_mark, strict=True)]
    (first, one), (second, two) = (
        seen_through(gray, mark, camera, tuple(pair[k] for pair in starts), margin=margin, blur=blur) for k in (0, 1)
    )
    independent = one.window.weight.sum(axis=1) / np.maximum(one.shared, two.shared)
    other = _doubt(first, second, independent, prior)
    chosen = _weighed(first, second, other)
    for i in np.flatnonzero(chosen.good & first.good & second.good):
        tilt = Tilt.of(mark, camera, *((second, two) if other[i] > 0.5 else (first, one)), int(i))
        mean = tilt.mean(prior) if tilt.upright() < _MERGED else None
        if mean is not None:
            chosen.q[i], chosen.covariance[i], chosen.doubt[i] = mean
    return chosen


def _doubt(first: MarkFit, second: MarkFit, independent: Array, prior: tuple[Array, float] | None) -> Array:
    """Return the probability (B,) of the second tilt; independent (B,): the number of independent pixels."""
    odds = independent * np.log(_misfit(second) / _misfit(first))  # log odds of the first over the second
    if prior is not None:
        normal, sd = prior
        away = [np.array([_angle(p.rotation[:, 2], normal) for p in f.poses or ()]) for f in (first, second)]
        odds = odds + (away[1] ** 2 - away[0] ** 2) / (2 * sd**2)
    sure = np.where(first.good, _SURE, -_SURE)
    decided: Array = np.where(first.good == second.good, odds, sure).clip(-_SURE, _SURE).astype(np.float64)
    return np.asarray(1.0 / (1.0 + np.exp(decided)))


def _misfit(fit: MarkFit) -> Array:
    """Return the rms residual (B,) over the contrast, where a left-out pixel counts with at least its limit.

    Otherwise the tilt that contradicts more of the picture might look better in the pixels that it keeps.
    """
    return np.asarray(np.sqrt((1 - fit.hidden) * fit.misfit**2 + fit.hidden * HIDDEN**2).clip(1e-9))


def _angle(a: Array, b: Array) -> float:
    """Return the angle between two lines, rad."""
    return float(np.arccos(min(float(abs(a @ b) / np.linalg.norm(b)), 1.0)))


def _weighed(first: MarkFit, second: MarkFit, other: Array) -> MarkFit:
    """Return the likelier fit of each mark, with the mean position of both; other (B,): the second's probability."""
    pick = {}
    for name in MarkFit.__slots__:
        if name != "poses":
            a, b = getattr(first, name), getattr(second, name)
            pick[name] = np.where((other > 0.5).reshape(-1, *[1] * (a.ndim - 1)), b, a)
    p = np.where(np.isfinite(first.q + second.q).all(axis=1), other, (other > 0.5).astype(float))
    apart = np.nan_to_num(second.q - first.q)
    pick["q"] = np.nan_to_num(first.q) * (1 - p)[:, None] + np.nan_to_num(second.q) * p[:, None]
    spread = (p * (1 - p))[:, None, None] * apart[:, :, None] * apart[:, None, :]
    both = (1 - p)[:, None, None] * first.covariance + p[:, None, None] * second.covariance
    pick["covariance"], pick["doubt"] = both + spread, np.minimum(p, 1 - p)
    pairs = zip(first.poses or (), second.poses or (), other > 0.5, strict=True)
    return MarkFit(**pick, poses=tuple(b if o else a for a, b, o in pairs))


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """The misfit of one mark's picture as a function of its tilt, about a pose that fits.

    q (2,): pixel that positions are relative to; L (3, 3): rays from positions there; scale: depth in units of L. sight
    (3, 3): rotation whose z is the line of sight, rotated as the mark is. lean (2,): the fitted tilt, rad about the
    axes of `sight`. H (9,) at it, with H_33 = 1; slope (9,), curve (9, 9): derivatives of half the chi-square by H.
    places (3,): x, y, log depth there.
    """

    q: Array
    L: Array
    scale: float
    sight: Array
    lean: Array
    H: Array
    slope: Array
    curve: Array
    places: Array
    turned: bool

    @classmethod
    def of(cls, mark: Mark, camera: Camera, fit: MarkFit, seen: CameraFit, i: int) -> Tilt:
        """Return the misfit about the i-th fitted pose."""
        geometry = posed(turned=not mark.concentric)
        parameters = seen.parameters[i : i + 1]
        H = geometry.homography(parameters)
        unit = H / H[:, 2:, 2:]
        basis = np.eye(9).reshape(1, 9, 3, 3)
        borders = borders_of(mark)
        pixels, weight = seen.window.pixels[i : i + 1], seen.weight[i]
        shown = parameters[:, geometry.levels]
        value, J = picture_with_slopes(borders, pixels, unit, basis, shown, loose=LOOSE)
        J[..., -LOOSE:] *= shown[:, -LOOSE:] != 0  # the fitted ones
        r, J = (value[0] - seen.window.values[i]) * weight, J[0] * weight[:, None]
        variance = max(float(r @ r), 1e-12) / max(float(weight.sum()) - geometry.free, 1.0)
        variance *= float(seen.shared[i])
        shape, levels = J[:, _SHAPE], np.delete(J, _SHAPE, axis=1)
        clear = shape - levels @ np.linalg.lstsq(levels.T @ levels, levels.T @ shape, rcond=None)[0]
        pose = (fit.poses or ())[i]
        sight, lean = _leaning(pose.rotation, camera.unproject(seen.q[i]))
        at = np.linalg.solve(seen.L[i], pose.translation)
        places = np.array([at[0] / at[2], at[1] / at[2], np.log(at[2] / seen.scale[i])])
        return cls(
            q=seen.q[i],
            L=seen.L[i],
            scale=float(seen.scale[i]),
            sight=sight,
            lean=lean,
            H=unit.ravel(),
            slope=clear.T @ r / variance,
            curve=clear.T @ clear / variance,
            places=places,
            turned=not mark.concentric,
        )

    def upright(self) -> float:
        """Return the excess of the upright pose's chi-square over that of the fitted one."""
        there, here = self.at(np.stack([np.zeros(2), self.lean]))[0]
        return float(there - here)

    def at(self, lean: Array) -> tuple[Array, Array, Array]:
        """Return chi-squares (G,) of tilts (G, 2) at their best positions, those (G, 2) from q, and covariances."""
        geometry, R = posed(turned=self.turned), self._rotations(lean)
        held = np.asarray(np.linalg.solve(self.L, R) / self.scale, np.float64).reshape(-1, 9)
        g = np.zeros((len(lean), geometry.count))
        g[:, :3] = self.places
        H, D = _unit(geometry, g, held)
        free = [0, 1, 2, 5] if self.turned else [0, 1, 2]
        D = np.swapaxes(D[:, free], 1, 2)  # (G, 9, f)
        off = H - self.H
        push = off @ self.curve + self.slope
        A = np.swapaxes(D, 1, 2) @ self.curve @ D
        A = (A + np.swapaxes(A, 1, 2)) / 2
        inverse = np.asarray(np.linalg.pinv(A, hermitian=True), np.float64)
        b = (np.swapaxes(D, 1, 2) @ push[..., None])[..., 0]
        step = -(inverse @ b[..., None])[..., 0]
        chi2 = np.einsum("gi,gi->g", off, push + self.slope) + np.einsum("gi,gi->g", b, step)
        return chi2, self.places[:2] + step[:, :2], inverse[:, :2, :2]

    def _rotations(self, lean: Array) -> Array:
        return np.asarray(self.sight @ so3.exp(np.column_stack([lean, np.zeros(len(lean))])))

    def mean(self, prior: tuple[Array, float] | None) -> tuple[Array, Array, float] | None:
        """Return the mean position (2,) px over all likely tilts, its covariance, and the probability of the other.

        prior: the plane's normal in the camera frame and its standard deviation, rad. None where tilts beyond the
        validity of the quadratic form are likely.
        """
        reach = self._reach(prior)
        if reach is None:
            return None
        side = np.linspace(-reach, reach, _SIDE)
        lean = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        lean = lean[np.hypot(*lean.T) <= reach]
        chi2, place, covariance = self.at(lean)
        chi2 = chi2 + self._against(prior, lean)
        w = np.exp(-0.5 * (chi2 - chi2.min()))
        w /= w.sum()
        middle = w @ place
        off = place - middle
        spread = np.einsum("g,gi,gj->ij", w, off, off) + np.einsum("g,gij->ij", w, covariance)
        return self.q + middle, spread, float(min(w[lean @ self.lean < 0].sum(), 0.5))

    def _reach(self, prior: tuple[Array, float] | None) -> float | None:
        """Return the largest likely tilt, rad; None beyond `_STEEPEST`."""
        radii = _STEEPEST * 0.75 ** np.arange(_RINGS)[::-1]
        turn = np.arange(_SPOKES) * (2 * np.pi / _SPOKES)
        lean = (radii[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)).reshape(-1, 2)
        lean = np.concatenate([[self.lean], lean])
        chi2 = self.at(lean)[0] + self._against(prior, lean)
        likely = (chi2[1:] - chi2.min() < _UNLIKELY).reshape(_RINGS, _SPOKES).any(axis=1)
        if not likely.any():
            return float(radii[0])
        last = int(np.flatnonzero(likely)[-1])
        return None if last + 1 == _RINGS else float(radii[last + 1])

    def _against(self, prior: tuple[Array, float] | None, lean: Array) -> Array:
        if prior is None:
            return np.zeros(len(lean))
        normal, sd = prior
        axis = self._rotations(lean)[..., 2]
        cosine = np.abs(axis @ normal) / np.linalg.norm(normal)
        return np.asarray((np.arccos(np.minimum(cosine, 1.0)) / sd) ** 2)


def _leaning(R: Array, ray: Array) -> tuple[Array, Array]:
    """Return S and w with R = S exp(w_x, w_y, 0) and the z of S along the ray."""
    sight = toward(ray)
    local = sight.T @ R
    axis = np.cross([0.0, 0.0, 1.0], local[:, 2])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, local[2, 2]))
    w = axis * (angle / sine) if sine > 1e-12 else np.zeros(3)
    spin = so3.exp(-w) @ local  # about z, before tilting: local = exp(w) spin = spin exp(spin^T w)
    return sight @ spin, (spin.T @ w)[:2]


def _unit(geometry: Geometry, g: Array, held: Array) -> tuple[Array, Array]:
    """Return H (G, 9) with H_33 = 1 and its derivatives (G, k, 9)."""
    H, D = with_slopes(geometry, g, held)
    last, unit = H[:, 2, 2], H / H[:, 2:, 2:]
    D = (D - unit[:, None] * D[:, :, 2:, 2:]) / last[:, None, None, None]
    return unit.reshape(-1, 9), D.reshape(*D.shape[:2], 9)
