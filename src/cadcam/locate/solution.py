"""The pose solved from the photos' steps, measured on the part's lines near it.

Each step is fitted to the pixels (`image.profile`), first where it is seen, then on the line itself, and the pose
solved for by a regression that knows that edges err as a whole (`fit.grouped`): a chamfer, a shadow or paint shifts all
samples of an edge together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, quantile
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.fit.grouped import GroupedFit, grouped_fit
from cadcam.geometry.rigid import Rigid
from cadcam.locate.bands import banded, share_beside_bands
from cadcam.locate.cells import Cells, Measured, measure
from cadcam.locate.edges import Projected
from cadcam.locate.evidence import Evidence, rows_of
from cadcam.locate.freedom import Freedom
from cadcam.locate.response import bend_of, leanings, straightened
from cadcam.locate.sight import Sight, nearest_steps

Longs = npt.NDArray[np.int64]
CLOSE_PX = 3  # px: how far from the lines their steps may be after the search
_ON_LINE = 0.7  # px: steps this near are fitted on the line itself
_USUAL_PX = 0.05  # by which edges are off as a whole
_LIMB_PX = 0.2  # by which the border of a round surface is off: it darkens ever faster towards it, or brightens
_UNEVEN = 0.4  # of what edges are off by as a whole: they are off by that beside, they turn and bend too
LOOSE_PX = 0.25  # by which edges of a good pose are seldom off as a whole
_ROUNDS = (3, 8, 8, 8)  # reweightings in the first measurement, the second, and more where it is not settled
_SETTLED_PX = 0.2  # by which nine tenths of the lines may move in the last step
_EVERY = 4  # of how many samples one tells whether the camera's response is bent
_PIECES = 30  # groups that the edges are cut into at least


@dataclass(frozen=True, slots=True)
class EdgeOptions:
    """How edges are looked for.

    search_px: how far from the start's lines the photo's may lie. step_px: length of the cell that a sample stands for.
    reach_px: how far to each side of a line its pixels are used; room_px: the least of that, nearer to another line a
    sample is left out. group_px: length of edge that is taken to err as one.
    """

    search_px: float = 8.0
    step_px: float = 4.0
    reach_px: float = 4.5
    room_px: float = 2.5
    group_px: float = 150.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise BadValue(name, value, "a positive number of px")


EDGES = EdgeOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The refined pose, and what was measured for its last step from `before`, in `cells`: x in the basis B there."""

    sights: Sequence[Sight]
    before: Rigid
    pose: Rigid
    B: Array
    places: Sequence[Projected]
    measured: Sequence[Measured]
    fit: GroupedFit
    cells: Sequence[Cells]

    @property
    def moved(self) -> list[Array]:
        """Return by how much (n,) px the last step moved the samples of each photo along their normals."""
        return [at.row @ (self.B @ self.fit.x) for at in self.places]

    @property
    def beside_bands(self) -> float:
        """Return the largest share of a photo's cells that lies beside bands (`locate.bands`)."""
        looked = zip(self.sights, self.places, self.cells, strict=True)
        return max(share_beside_bands(*one, np.zeros(len(one[0].samples))) for one in looked)


def solved(
    sights: Sequence[Sight],
    pose: Rigid,
    freedom: Freedom,
    evidence: Sequence[Evidence],
    options: EdgeOptions,
    *,
    bands: bool = False,
) -> Solution:
    """Return the pose after measuring steps where they are first seen, then on the lines themselves.

    bands: whether cells are told of bands beside the lines, which the model does not have (`locate.bands`).
    """
    half = 0.5 * options.step_px
    places = [s.project(pose) for s in sights]
    room = {"half_length": half, "reach_px": options.reach_px, "room_px": options.room_px}
    where = [nearest_steps(s, at, half_length=half, reach=CLOSE_PX) for s, at in zip(sights, places, strict=True)]
    cells = [Cells.of(s, at, where=w, **room) for s, at, w in zip(sights, places, where, strict=True)]
    pieces, on_lines = _pieces(sights, options), False
    for number, iterations in enumerate(_ROUNDS):
        told = [(c, None if number else c.first) for c in cells]
        if bands and number:
            anew = room if number == 1 else None
            looked = [banded(*one, anew) for one in zip(sights, places, cells, where, strict=True)]
            cells, told = [c for c, _, _ in looked], [(c, sums) for _, c, sums in looked]
        measured = [
            measure(s, at, c, w, sums=sums) for s, at, (c, sums), w in zip(sights, places, told, where, strict=True)
        ]
        B = freedom.at(pose)
        other = rows_of(evidence, [s.photo for s in sights], pose)
        fit = _step(sights, places, measured, other, B, iterations, pieces, on_lines=on_lines)
        on_lines = fit.between < LOOSE_PX
        last = Solution(sights, pose, pose @ Rigid.exp(B @ fit.x), B, places, measured, fit, cells)
        pose = last.pose
        where = [_left(m, moved) for m, moved in zip(measured, last.moved, strict=True)]
        if number and quantile(np.abs(np.concatenate(last.moved)), 0.9) < _SETTLED_PX:
            break
        places = [s.project(pose) for s in sights]
    return _unbent(last, [c.blur for c in cells], other, iterations, pieces)


def _unbent(
    last: Solution,
    blurs: Sequence[float],
    evidence: tuple[Array, Array, Array],
    iterations: int,
    pieces: Sequence[Longs],
) -> Solution:
    """Return the solution with what a bent response of the camera does to the steps taken out, where it shows.

    Borders of round surfaces do not tell it: light shifts them as well, all to the inside.
    """
    sights, places, measured = last.sights, last.places, last.measured
    use = [np.flatnonzero(m.usable) for m in measured]
    ends = np.cumsum([len(u) for u in use])
    told = [np.flatnonzero(s.samples.chain[u] >= 0)[::_EVERY] for s, u in zip(sights, use, strict=True)]
    few = [u[k] for u, k in zip(use, told, strict=True)]
    groups = np.split(last.fit.group[: ends[-1]], ends[:-1])
    group = np.concatenate([g[k] for g, k in zip(groups, told, strict=True)])
    rows = np.concatenate([at.row[k] for at, k in zip(places, few, strict=True)]) @ last.B
    lean = np.concatenate([leanings(*one) for one in zip(sights, places, few, blurs, strict=True)])
    bend = bend_of(last.fit, rows, lean, group) if len(lean) else None
    if bend is None:
        return last
    leans = [leanings(*one) for one in zip(sights, places, use, blurs, strict=True)]
    lean = np.concatenate(leans)
    measured = straightened(measured, leans, bend)
    fit = _step(sights, places, measured, evidence, last.B, iterations, pieces, on_lines=True)
    by_bend = bend.sd * fit.gain[:, : len(lean)] @ lean
    fit = replace(fit, covariance=fit.covariance + np.outer(by_bend, by_bend))
    return replace(last, pose=last.before @ Rigid.exp(last.B @ fit.x), measured=measured, fit=fit)


def _left(measured: Measured, moved: Array) -> Array:
    """Return where to fit the steps after the lines moved: on the lines, but for edges that stay away from them."""
    left = np.where(measured.usable, measured.offset, 0.0) - moved
    return np.where(np.abs(left) < _ON_LINE, 0.0, left) * measured.usable


def _step(
    sights: Sequence[Sight],
    places: Sequence[Projected],
    measured: Sequence[Measured],
    evidence: tuple[Array, Array, Array],
    B: Array,
    iterations: int,
    pieces: Sequence[Longs],
    *,
    on_lines: bool,
) -> GroupedFit:
    """Return the step in the basis B that the offsets and the other evidence ask for.

    pieces: of edge, on which the samples of each photo lie. on_lines: whether the lines are known to lie on their own
    steps. Then it is light that shifts them; before, they may lie on others', and clear ones are off as far as faint
    ones.
    """
    other, rows, other_variance = evidence
    if not np.isfinite(rows).all():
        raise DegenerateGeometry("points or lines given as evidence are not in front of their camera")
    y = np.concatenate([*(m.offset[m.usable] for m in measured), other])
    variance = np.concatenate([*(m.sigma[m.usable] ** 2 for m in measured), other_variance])
    J = np.concatenate([*(at.row[m.usable] for at, m in zip(places, measured, strict=True)), rows]) @ B
    piece = np.concatenate([of[m.usable] for of, m in zip(pieces, measured, strict=True)])
    group, line = (np.cumsum(np.diff(of, prepend=of[:1]) > 0, dtype=np.int64) for of in piece.T)
    expected = _expected(sights, measured, group)
    edges, alone = len(expected), np.arange(len(other))
    of_group, of_line = (_relative(variance[: len(of)], of, on_lines) for of in (group, line))
    family = line[np.flatnonzero(np.diff(group, prepend=-1))]
    return grouped_fit(
        y,
        J,
        variance,
        np.concatenate([group, edges + alone]),
        usual=_USUAL_PX,
        relative=np.concatenate([of_group, np.ones(len(other))]),
        uneven=_UNEVEN,
        expected=np.concatenate([expected, np.zeros(len(other))]),
        exact=np.arange(edges + len(other)) >= edges,
        family=np.concatenate([family, len(of_line) + alone]),
        family_relative=np.concatenate([of_line, np.ones(len(other))]),
        iterations=iterations,
    )


def _relative(variance: Array, group: Longs, on_lines: bool) -> Array:
    """Return how the variances compare (G,) by which groups are off as a whole: as those of their means by noise.

    Shadows, reflections and texture add to a step of brightness as noise does: they shift it the less the higher it is,
    and are less alike along a longer edge. How much there is of them, which few edges tell poorly, then hardly moves
    the pose, only what is told of it. on_lines: whether that is so.
    """
    told = np.bincount(group, 1 / variance)
    return np.asarray(np.mean(told) / told if on_lines and len(told) else np.ones(len(told)))


def _expected(sights: Sequence[Sight], measured: Sequence[Measured], group: Longs) -> Array:
    """Return by how much groups beside bands and on borders of round surfaces are expected to be off (G,), px^2.

    Towards such a border brightness changes with the root of the distance, which no slope of the ground describes.
    """
    if not len(group):
        return np.zeros(0)
    round_off = np.concatenate([s.samples.chain[m.usable] < 0 for s, m in zip(sights, measured, strict=True)])
    doubt = np.concatenate([m.doubt[m.usable] for m in measured])
    return np.asarray(np.bincount(group, _LIMB_PX**2 * round_off + doubt**2) / np.bincount(group))


def _pieces(sights: Sequence[Sight], options: EdgeOptions) -> list[Longs]:
    """Return numbers (N, 2) of the piece of line, and of the line, that the samples of each photo lie on.

    They ascend, over all photos together. Parts that are small in the picture have shorter pieces: a few groups would
    not tell how they scatter.
    """
    most = min(options.group_px / options.step_px, sum(len(s.samples) for s in sights) / _PIECES)
    most = max(int(most), 5)
    out, before = [], 0
    for sight in sights:
        run = sight.samples.run.astype(np.int64)
        count = np.bincount(run)
        place = np.arange(len(run)) - (np.cumsum(count) - count)[run]
        pieces = np.maximum(np.round(count / most), 1)[run].astype(np.int64)
        number = before + run * len(run) + place * pieces // np.maximum(count, 1)[run]
        out.append(np.stack([number, before + run * len(run)], axis=1))
        before += (int(run.max(initial=-1)) + 1) * len(run)
    return out
