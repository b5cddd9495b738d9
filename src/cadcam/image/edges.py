"""Edges of a picture at sub-pixel positions, and how far given points are from them.

J. Canny, A computational approach to edge detection, PAMI 8 (1986): derivative of a Gaussian, maxima along the
gradient, hysteresis. Sub-pixel step after F. Devernay, INRIA RR-2724 (1995) in the form of R. Grompone von Gioi and
G. Randall, IPOL 7 (2017): the peak is searched for along the image axis nearer to the gradient, where no interpolation
between pixels is needed. Here the peak is that of a Gaussian through the three magnitudes (a parabola through their
logarithms): the exact shape of the response to a Gaussian-blurred step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Ids, Mask, Picture, frozen
from cadcam.errors import BadValue
from cadcam.image.picture import checked

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_NOISE_FACTOR = 5.0  # Rayleigh scales: exp(-5**2/2), so 4 noise maxima in a million pixels start an edge
_LEAST_CONTRAST = 8.0 / 255.0  # of a step that starts an edge: below it lie quantisation and JPEG blocks
_LOW_SHARE = 0.4  # of the high threshold, Canny's own 2:1 to 3:1
_TOGETHER = 2_000_000  # neighbours examined at a time: bounds the memory
_SECTORS = 16  # of direction: edges are searched in one tree per sector


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EdgePoints(Brief):
    """Edge points of a picture: `q` (N, 2) pixel positions (x, y), pixel centres at integers.

    `normal` (N, 2) is the unit gradient, from dark to bright; `strength` (N,) the gradient's magnitude in grey value
    per pixel after smoothing (a step of contrast c and blur b smoothed by sigma has c / sqrt(2 pi (b^2 + sigma^2)));
    `chain` (N,) numbers the 8-connected curves from 0.
    """

    q: Array
    normal: Array
    strength: Array
    chain: Ids

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.strength))
        object.__setattr__(self, "q", frozen(self.q, "q", (n, 2)))
        object.__setattr__(self, "normal", frozen(self.normal, "normal", (n, 2)))
        object.__setattr__(self, "strength", frozen(self.strength, "strength", (n,)))
        object.__setattr__(self, "chain", frozen(self.chain, "chain", (n,), np.int32))

    def __len__(self) -> int:
        return len(self.q)

    def mask(self, size: tuple[int, int]) -> Mask:
        """Return an (H, W) mask, true at the pixels nearest to the points, for a picture of `size` (W, H)."""
        mask = np.zeros((size[1], size[0]), bool)
        x, y = np.rint(self.q).astype(np.intp).T
        inside = (x >= 0) & (x < size[0]) & (y >= 0) & (y < size[1])
        mask[y[inside], x[inside]] = True
        return mask


def canny(
    gray: npt.ArrayLike, *, sigma: float = 1.0, low: float | None = None, high: float | None = None
) -> EdgePoints:
    """Return the edge points of a grey picture (H, W): maxima of the smoothed gradient along its direction.

    `sigma` (px) is the Gaussian's width. A curve is kept where it is stronger than `low` throughout and `high`
    somewhere, both in grey value per pixel after smoothing. By default `high` is five times the gradient's Rayleigh
    scale (its median / sqrt(2 ln 2); in a picture mostly free of edges, that of its noise or texture), at least that
    of a step of 8/255; `low` is 0.4 of `high`. Raises `BadValue`.
    """
    values = checked(gray)
    if values.ndim != 2:
        raise BadValue("picture", f"of shape {values.shape}", "a grey picture (H, W); to_gray makes one")
    if not 0.3 <= sigma <= 100:
        raise BadValue("sigma", sigma, "0.3 to 100 pixels")
    gx, gy = _gradient(values, sigma)
    magnitude = np.hypot(gx, gy)
    high = _automatic_threshold(magnitude, sigma) if high is None else high
    low = _LOW_SHARE * high if low is None else low
    if not 0 <= low <= high:
        raise BadValue("low, high", (low, high), "0 <= low <= high")
    index, offset, strength = _maxima(gx, gy, magnitude, low)
    keep, chain = _hysteresis(values.shape, index, strength, high)
    index, offset = index[keep], offset[keep]
    normal = np.column_stack([gx.flat[index], gy.flat[index]]).astype(np.float64)
    normal /= np.hypot(normal[:, 0], normal[:, 1])[:, None]
    y, x = np.divmod(index, values.shape[1])
    return EdgePoints(np.column_stack([x, y]) + offset, normal, strength[keep], chain[keep])


def distance_to_edges(
    edges: EdgePoints, q: npt.ArrayLike, *, normal: npt.ArrayLike | None = None, within: float = math.radians(20)
) -> Array:
    """Return the distance (N,) in px of points `q` (N, 2) to the nearest edge point, inf where there is none.

    With `normal` (N, 2) only edge points count whose normal is, up to sign, within `within` (rad) of the point's
    normal: a CAD edge does not know which of its sides looks brighter. NaN points give NaN.
    """
    points = frozen(q, "q", (None, 2), finite=False)
    distance = np.full(len(points), np.inf)
    usable = np.isfinite(points).all(axis=1)
    distance[~usable] = np.nan
    if normal is None:
        if len(edges) and usable.any():
            distance[usable] = _tree(edges.q).query(points[usable])[0]
        return distance
    if not 0 < within <= math.pi / 2:
        raise BadValue("within", within, "an angle up to pi/2 (rad)")
    wanted = frozen(normal, "normal", (len(points), 2), finite=False)
    angle = np.arctan2(wanted[:, 1], wanted[:, 0])
    sector = np.floor(np.where(np.isfinite(angle), angle, 0.0) / math.pi * _SECTORS).astype(int) % _SECTORS
    of_edge = np.arctan2(edges.normal[:, 1], edges.normal[:, 0])
    for k in range(_SECTORS):
        mine = np.flatnonzero(usable & (sector == k))
        middle = (k + 0.5) * math.pi / _SECTORS
        near = np.flatnonzero(_apart(of_edge, middle) <= within + 0.5 * math.pi / _SECTORS)
        if mine.size and near.size:
            distance[mine] = _nearest_agreeing(edges.q[near], of_edge[near], points[mine], angle[mine], within)
    return distance


def _gradient(values: Picture, sigma: float) -> tuple[Picture, Picture]:
    from scipy.ndimage import gaussian_filter1d

    def along(axis: int) -> Picture:
        smooth = gaussian_filter1d(values, sigma, axis=1 - axis, mode="nearest")
        slope: Picture = gaussian_filter1d(smooth, sigma, axis=axis, order=1, mode="nearest")
        return slope

    return along(1), along(0)


def _automatic_threshold(magnitude: Picture, sigma: float) -> float:
    stride = max(1, math.isqrt(magnitude.size // 1_000_000))
    scale = float(np.median(magnitude[::stride, ::stride])) / math.sqrt(2 * math.log(2))
    faintest = _LEAST_CONTRAST / math.sqrt(2 * math.pi * (sigma**2 + 0.7**2))  # 0.7 px: the blur of a sharp lens
    return max(_NOISE_FACTOR * scale, faintest)


def _maxima(gx: Picture, gy: Picture, magnitude: Picture, low: float) -> tuple[npt.NDArray[np.intp], Array, Array]:
    """Return flat index, sub-pixel offset (N, 2) and height of the maxima along the axis nearer to the gradient."""
    width = magnitude.shape[1]
    strong = magnitude > low
    strong[[0, -1]] = strong[:, [0, -1]] = False
    index = np.flatnonzero(strong)
    horizontal = np.abs(gx.ravel()[index]) >= np.abs(gy.ravel()[index])
    step = np.where(horizontal, 1, width)
    flat = magnitude.ravel()
    before, here, after = flat[index - step], flat[index], flat[index + step]
    peak = (here > before) & (here >= after)
    index, horizontal = index[peak], horizontal[peak]
    smallest = np.finfo(np.float32).tiny
    left, mid, right = (np.log(np.maximum(m[peak], smallest).astype(np.float64)) for m in (before, here, after))
    slope, bend = 0.5 * (right - left), left + right - 2 * mid  # bend < 0 at a strict maximum on the left side
    shift = -slope / bend
    offset = np.where(horizontal[:, None], [1.0, 0.0], [0.0, 1.0]) * shift[:, None]
    return index, offset, np.exp(mid + 0.5 * slope * shift)


def _hysteresis(shape: tuple[int, ...], index: npt.NDArray[np.intp], strength: Array, high: float) -> tuple[Mask, Ids]:
    """Return which maxima belong to a curve that reaches `high`, and the number of each one's curve."""
    from scipy.ndimage import label

    mask = np.zeros(shape, bool)
    mask.flat[index] = True
    labels, count = label(mask, structure=np.ones((3, 3), bool))
    curve = labels.ravel()[index]
    reaches = np.zeros(count + 1, bool)
    reaches[curve[strength >= high]] = True
    number = np.cumsum(reaches) - 1
    return reaches[curve], number[curve].astype(np.int32)


def _apart(a: Array, b: Array | float) -> Array:
    """Return the angle between undirected lines of directions a and b, 0 to pi/2."""
    turn: Array = np.abs((a - b + math.pi / 2) % math.pi - math.pi / 2)
    return turn


def _tree(q: Array) -> cKDTree:
    from scipy.spatial import cKDTree

    return cKDTree(q, balanced_tree=False, compact_nodes=False)


def _nearest_agreeing(q: Array, of_edge: Array, points: Array, angle: Array, within: float) -> Array:
    """Return the distance of each point to the nearest q whose direction agrees, querying more and more neighbours."""
    tree, found = _tree(q), np.full(len(points), np.inf)
    left, k = np.arange(len(points)), 4
    while left.size:
        k = min(k, len(q))
        still = []
        for some in np.array_split(left, -(-left.size * k // _TOGETHER)):
            far, which = tree.query(points[some], k=np.arange(1, k + 1))
            agrees = _apart(of_edge[which], angle[some, None]) <= within
            found[some] = np.where(agrees, far, np.inf).min(axis=1)
            still.append(some[~agrees.any(axis=1)])
        left = np.concatenate(still) if k < len(q) else left[:0]
        k *= 4
    return found
