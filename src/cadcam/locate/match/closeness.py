"""How close the photo's edges lie to each edge of the CAD model: the measure that Fig 3-16 and 3-17 leave open.

Two measures, side by side. Direct: which share of each visible CAD edge has a photo edge of its direction near it, how
far off that is along the normal, and how often this would happen by chance. By vote, as in a Hough transform: every
pair of a sample of the CAD edge and an edge point of the photo votes for the shift along the normal that would bring
one onto the other; the shift with most votes wins, anywhere within reach.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Ids, frozen
from cadcam.errors import BadValue
from cadcam.image.edges import EdgePoints, canny
from cadcam.image.picture import checked
from cadcam.kinds import expect, expect_numbers, expect_positive
from cadcam.render.lines.wireframe import Wireframe

_SHIFTED = (17.0, -17.0, 23.0, -23.0)  # px along the normal at which the chance level is measured
_SIGMA_TO_MAD = 1.4826
_TINY_PX = 1e-9  # length of an edge that is seen as a point


@dataclass(frozen=True, slots=True)
class ClosenessOptions:
    """What counts as close.

    near: px between a CAD edge and a photo's edge, along the normal; within: rad between their directions. step: px
    between samples along an edge. reach: px, the largest shift that is voted on; cell: px, the width of a vote.
    """

    near: float = 3.0
    within: float = math.radians(15)
    step: float = 1.0
    reach: float = 20.0
    cell: float = 0.5

    def __post_init__(self) -> None:
        expect_numbers(self)
        for name in ("near", "step", "reach", "cell"):
            expect_positive(getattr(self, name), name, "a positive number of px")
        if not 0 < self.within <= math.pi / 2:
            raise BadValue("within", self.within, "rad, above 0, at most pi/2")
        if not self.reach > self.cell:
            raise BadValue("reach", self.reach, f"more px than those of a cell, {self.cell:g}")


PLAIN_CLOSENESS = ClosenessOptions()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Closeness(Brief):
    """M visible CAD edges (chains of the wireframe) and how close the photo's edges are.

    chain (M,); length (M,) px that is visible; q (M, 2) px, the middle of what is visible. Direct: share (M,) of the
    length with an edge of its direction near it; offset (M,) px, median along the normal, photo minus model, and
    scatter (M,) px about it (a standard deviation, from the median absolute deviation), nan where there is none; chance
    (M,): the share that shifted copies of the edge have. By vote: shift (M,) px along the normal, and votes (M,), the
    share of the length that agrees on it; nan and 0 without any vote. The normal points to the right of the direction
    in which a chain runs, as seen in the picture.
    """

    chain: Ids
    length: Array
    q: Array
    share: Array
    offset: Array
    scatter: Array
    chance: Array
    shift: Array
    votes: Array

    def __post_init__(self) -> None:
        m = len(np.atleast_1d(self.length))
        object.__setattr__(self, "chain", frozen(self.chain, "chain", (m,), np.int32))
        object.__setattr__(self, "q", frozen(self.q, "q", (m, 2)))
        for name in ("length", "share", "offset", "scatter", "chance", "shift", "votes"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"closeness' {name}", (m,), finite=False))

    def __len__(self) -> int:
        return len(self.length)

    @property
    def excess(self) -> Array:
        """Return by how much (M,) an edge is better supported than by chance: (share - chance)/(1 - chance)."""
        return np.asarray((self.share - self.chance) / np.maximum(1 - self.chance, 1e-9))

    @property
    def total(self) -> float:
        """Return the share of the whole visible length that is close beyond chance: 1 is all, 0 no more than chance."""
        return float(np.average(self.excess, weights=self.length)) if len(self) else 0.0


def edge_closeness(
    photo: npt.ArrayLike | EdgePoints, wireframe: Wireframe, *, options: ClosenessOptions = PLAIN_CLOSENESS
) -> Closeness:
    """Return how close a photo's edges are to each visible edge of a wireframe; photo: a grey picture, or its edges.

    Samples outside the picture do not count.
    """
    expect(wireframe, "wireframe", Wireframe)
    expect(options, "options", ClosenessOptions)
    edges = photo if isinstance(photo, EdgePoints) else canny(checked(photo))
    q, normal, line, px = wireframe.visible.points_along(options.step)
    seen = wireframe.camera.sees(q)
    q, normal, chain, px = q[seen], normal[seen], wireframe.visible.chain[line[seen]], px[seen]
    chains, of = np.unique(chain, return_inverse=True)
    grid = _EdgeGrid(edges, options)
    offsets = grid.nearest(q, normal)
    length = np.asarray(np.bincount(of, px, len(chains)), np.float64)
    beside = np.stack([_share(grid.nearest(q + d * normal, normal), of, px, length) for d in _SHIFTED])
    chance = np.asarray(beside.mean(axis=0), np.float64)
    middle = np.stack([np.bincount(of, px * q[:, k], len(chains)) for k in range(2)], axis=1).astype(np.float64)
    middle /= np.maximum(length, _TINY_PX)[:, None]
    offset, scatter = _median_and_scatter(offsets, of, len(chains))
    shift, votes = _voted(grid, q, normal, of, px, length, options)
    share = _share(offsets, of, px, length)
    return Closeness(chains.astype(np.int32), length, middle, share, offset, scatter, chance, shift, votes)


class _EdgeGrid:
    """Edge points indexed by pixel, to be looked up along normals."""

    def __init__(self, edges: EdgePoints, options: ClosenessOptions) -> None:
        self.options = options
        self.low = np.floor(edges.q.min(axis=0, initial=0.0)).astype(int) - 1 if len(edges) else np.zeros(2, int)
        high = np.ceil(edges.q.max(axis=0, initial=1.0)).astype(int) + 2 if len(edges) else np.ones(2, int) * 2
        self.number = np.full((high[1] - self.low[1], high[0] - self.low[0]), -1, np.int64)
        x, y = (np.rint(edges.q).astype(int) - self.low).T if len(edges) else np.zeros((2, 0), int)
        self.number[y, x] = np.arange(len(edges))
        self.q, self.normal = edges.q, edges.normal
        self.cosine = math.cos(options.within)

    def nearest(self, q: Array, normal: Array) -> Array:
        """Return the signed distance (N,) px along the normal to the nearest edge of like direction, or nan."""
        found = self.along(q, normal, self.options.near)
        order = np.argsort(np.where(np.isfinite(found), np.abs(found), np.inf), axis=1)[:, :1]
        return np.asarray(np.take_along_axis(found, order, axis=1)[:, 0])

    def along(self, q: Array, normal: Array, far: float) -> Array:
        """Return the signed distances (N, K) px of the edge points found along the normal, to both sides.

        nan where a step finds none of like direction, or one that an earlier step found.
        """
        steps = np.arange(-math.ceil(far), math.ceil(far) + 1)
        at = np.rint(q[:, None] + steps[:, None] * normal[:, None]).astype(int) - self.low
        h, w = self.number.shape
        inside = (at[..., 0] >= 0) & (at[..., 0] < w) & (at[..., 1] >= 0) & (at[..., 1] < h)
        x, y = np.where(inside, at[..., 0], 0), np.where(inside, at[..., 1], 0)
        k = np.where(inside, self.number[y, x], -1)
        repeated = np.zeros(k.shape, bool)
        repeated[:, 1:] = k[:, 1:] == k[:, :-1]
        met = (k >= 0) & ~repeated
        if not len(self.q):
            return np.full(k.shape, np.nan)
        distance = np.einsum("nki,ni->nk", self.q[k] - q[:, None], normal)
        parallel = np.abs(np.einsum("nki,ni->nk", self.normal[k], normal)) >= self.cosine
        return np.where(met & parallel & (np.abs(distance) <= far), distance, np.nan)


def _share(offsets: Array, of: npt.NDArray[np.intp], px: Array, length: Array) -> Array:
    """Return the share of each edge's length (M,) whose samples, of so many px (N,) each, have an offset."""
    return np.asarray(np.bincount(of, px * np.isfinite(offsets), len(length)) / np.maximum(length, _TINY_PX))


def _median_and_scatter(offsets: Array, of: npt.NDArray[np.intp], count: int) -> tuple[Array, Array]:
    """Return median and robust standard deviation (count,) of each edge's offsets; nan where it has none."""
    median, scatter = np.full(count, np.nan), np.full(count, np.nan)
    for k in range(count):
        mine = offsets[of == k]
        mine = mine[np.isfinite(mine)]
        if mine.size:
            median[k] = np.median(mine)
            scatter[k] = _SIGMA_TO_MAD * np.median(np.abs(mine - median[k]))
    return median, scatter


def _voted(
    grid: _EdgeGrid,
    q: Array,
    normal: Array,
    of: npt.NDArray[np.intp],
    px: Array,
    length: Array,
    options: ClosenessOptions,
) -> tuple[Array, Array]:
    """Return for each edge the shift with most votes, interpolated within its cell, and the share of votes."""
    from scipy.ndimage import gaussian_filter1d

    count, cells = len(length), 2 * math.ceil(options.reach / options.cell) + 1
    offsets = grid.along(q, normal, options.reach)
    cast = np.isfinite(offsets)
    cell = np.rint(np.where(cast, offsets, 0.0) / options.cell).astype(int) + cells // 2
    flat = (of[:, None] * cells + cell)[cast]
    weight = np.broadcast_to(px[:, None], cast.shape)[cast]
    table = np.bincount(flat, weight, count * cells).reshape(count, cells)
    smooth = gaussian_filter1d(table, 1.0, axis=1, mode="constant") * math.sqrt(2 * math.pi)
    best = smooth.argmax(axis=1)
    near = np.abs(np.arange(cells) - best[:, None]) <= 2
    votes = (table * near).sum(axis=1)
    places = (np.arange(cells) - cells // 2) * options.cell
    with np.errstate(invalid="ignore"):
        shift = (table * near * places).sum(axis=1) / np.where(votes > 0, votes, np.nan)
    return np.asarray(shift), np.minimum(votes / np.maximum(length, _TINY_PX), 1.0)
