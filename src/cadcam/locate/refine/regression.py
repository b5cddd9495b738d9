"""The step of the pose given the offsets of the photos' edges, by a regression with errors common to each edge.

A chamfer, a shadow or paint shifts all samples of an edge together: so pieces of edge have an offset of their own
(`fit.grouped`). Beside bands, which run along whole lines, that is not all. There the pieces of a line share an error,
and what bands do to the steps beyond what is modelled (`locate.lines.bands`) draws all lines to the same side, towards
dark or towards bright: one more unknown, with a prior. Steps up to white are another: how high they are follows from
the photo's blur.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from cadcam.arrays import Array, Longs
from cadcam.errors import DegenerateGeometry
from cadcam.fit.grouped import GroupedFit, Groups, grouped_fit
from cadcam.locate.lines.cells import StepOffsets
from cadcam.locate.lines.edges import Projected, numbered, pieces_of
from cadcam.locate.lines.sight import Sight
from cadcam.locate.refine.options import EdgeOptions
from cadcam.native.grouped import UNKNOWNS

_USUAL_PX = 0.05  # prior common offset of edges
_LIMB_PX = 0.2  # error of the border of a round surface, towards which it darkens ever faster, or brightens
_UNEVEN = 0.4  # share of the common offset of edges by which they are also uneven: rotated or bent
_DRAWN_PX = 0.05  # prior of what draws all lines towards dark or bright beside bands, beyond what is modelled
_PIECES = 30  # fewest groups that the edges are cut into


@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """The groups of each photo's samples: numbers (N, 2) of piece and line; bands: whether these lie beside lines."""

    sights: Sequence[Sight]
    pieces: Sequence[Longs]
    bands: bool = False

    @classmethod
    def of(cls, sights: Sequence[Sight], options: EdgeOptions, *, bands: bool) -> Regression:
        """Return the regression for the samples of photos."""
        return cls(sights, _pieces(sights, options), bands)

    def step(
        self,
        places: Sequence[Projected],
        measured: Sequence[StepOffsets],
        evidence: tuple[Array, Array, Array],
        B: Array,
        iterations: int,
        *,
        on_lines: bool,
    ) -> GroupedFit:
        """Return the step x (k,) in the basis B (6, k) by the offsets measured at `places`, and by the other evidence.

        evidence: offsets, Jacobian and variances of other observations (`locate.evidence.rows_of`). on_lines: whether
        the lines are known to lie on their own steps. Then it is light that shifts them; before, they may lie on
        others', and clear edges are as far off as faint ones. Raises `DegenerateGeometry` for evidence that the camera
        does not image, and for lines towards it.
        """
        other, rows, other_variance = evidence
        if not np.isfinite(rows).all():
            raise DegenerateGeometry(
                "points or lines given as evidence are not in front of their camera, or lines point at it"
            )
        y = np.concatenate([*(m.offset[m.usable] for m in measured), other])
        variance = np.concatenate([*(m.sigma[m.usable] ** 2 for m in measured), other_variance])
        J = np.concatenate([*(at.row[m.usable] for at, m in zip(places, measured, strict=True)), rows]) @ B
        piece, line = np.concatenate([of[m.usable] for of, m in zip(self.pieces, measured, strict=True)]).T
        drawn = self._drawn(measured, UNKNOWNS - B.shape[1])
        m = drawn.shape[1]
        if m:  # the last unknowns are how strongly; their priors, the last data
            columns = np.concatenate([drawn, np.zeros((len(other), m))])
            J, y = np.block([[J, columns], [np.zeros((m, B.shape[1])), np.eye(m)]]), np.append(y, np.zeros(m))
            variance = np.append(variance, np.ones(m))
        groups = self._groups(measured, variance, piece, line, on_lines=on_lines)
        fit = grouped_fit(y, J, variance, groups, usual=_USUAL_PX, uneven=_UNEVEN, iterations=iterations)
        return _undrawn(fit, drawn) if m else fit

    def _drawn(self, measured: Sequence[StepOffsets], most: int) -> Array:
        """Return by how much (n, m) px each of m causes draws the samples of many lines at once, sd and sign.

        Beside bands all to bright or all to dark; and steps up to white, those of each photo. At most so many: of very
        many photos with white those that have least share a cause, as if they were one.
        """
        used = [m.usable for m in measured]
        bright = -np.concatenate([np.sign(m.contrast[use]) for m, use in zip(measured, used, strict=True)])
        white = block_diag(*(m.white[use][:, None] for m, use in zip(measured, used, strict=True)))
        white = white[:, np.argsort(-(white**2).sum(axis=0), kind="stable")]
        most -= self.bands
        white = np.column_stack([white[:, : most - 1], white[:, most - 1 :].sum(axis=1)])
        return np.column_stack([*([_DRAWN_PX * bright] if self.bands else []), white[:, white.any(axis=0)]])

    def _groups(
        self, measured: Sequence[StepOffsets], variance: Array, piece: Longs, line: Longs, *, on_lines: bool
    ) -> Groups:
        """Return the groups of all data: those of offsets, by piece (n,), then one of its own for each exact datum.

        variance: of all data; exact are those whose error is noise alone: other evidence, and priors. Beside bands, the
        groups of a line form a family, with an error in common; line (n,): of each offset.
        """
        group, n = numbered(piece), len(piece)
        expected = _expected(self.sights, measured, group)
        edges, exact = len(expected), len(variance) - n
        family, of_family = None, None
        if self.bands:
            of_line = numbered(line)
            of_family = _relative(variance[:n], of_line, on_lines)
            begins = np.flatnonzero(np.diff(group, prepend=-1))
            family = np.concatenate([of_line[begins], len(of_family) + np.arange(exact)])
            of_family = np.concatenate([of_family, np.ones(exact)])
        return Groups(
            np.concatenate([group, edges + np.arange(exact)]),
            relative=np.concatenate([_relative(variance[:n], group, on_lines), np.ones(exact)]),
            expected=np.concatenate([expected, np.zeros(exact)]),
            exact=np.arange(edges + exact) >= edges,
            family=family,
            family_relative=of_family,
        )


def _undrawn(fit: GroupedFit, drawn: Array) -> GroupedFit:
    """Return the fit of the pose alone, with what draws many samples at once (n, m) left in the groups' offsets."""
    k, n, group = len(fit.x) - drawn.shape[1], len(fit.offset), fit.group[: len(drawn)]
    by = drawn @ fit.x[k:]
    drawn = np.bincount(group, by, n) / np.maximum(np.bincount(group, minlength=n), 1)
    return replace(fit, x=fit.x[:k], covariance=fit.covariance[:k, :k], offset=fit.offset + drawn, gain=fit.gain[:k])


def _relative(variance: Array, group: Longs, on_lines: bool) -> Array:
    """Return the relative variances (G,) of the groups' offsets: on their lines, those of their means by noise; else 1.

    Shadows, reflections and texture act on a brightness step like noise: they shift it the less the higher it is, and
    are less correlated along a longer edge. Their amount, which a few edges determine poorly, then hardly affects the
    pose, only its covariance. on_lines: whether lines are known to lie on their own steps, as this assumes.
    """
    told = np.bincount(group, 1 / variance)
    return np.asarray(np.mean(told) / told if on_lines and len(told) else np.ones(len(told)))


def _expected(sights: Sequence[Sight], measured: Sequence[StepOffsets], group: Longs) -> Array:
    """Return the expected variance (G,) px^2 of groups beside bands and on borders of round surfaces.

    Towards such a border brightness changes with the root of the distance, which no slope of the ground models.
    """
    if not len(group):
        return np.zeros(0)
    round_off = np.concatenate([s.samples.chain[m.usable] < 0 for s, m in zip(sights, measured, strict=True)])
    doubt = np.concatenate([m.doubt[m.usable] for m in measured])
    return np.asarray(np.bincount(group, _LIMB_PX**2 * round_off + doubt**2) / np.bincount(group))


def _pieces(sights: Sequence[Sight], options: EdgeOptions) -> list[Longs]:
    """Return numbers (N, 2) of the piece of line, and of the line, that the samples of each photo lie on.

    They ascend, over all photos together. Parts that are small in the picture have shorter pieces, because the scatter
    of a few groups could not be estimated.
    """
    most = min(options.group_px / options.step_px, sum(len(s.samples) for s in sights) / _PIECES)
    most = max(int(most), 5)
    out, before = [], 0
    for sight in sights:
        run = sight.samples.run
        out.append(before + np.stack([pieces_of(run, most), run.astype(np.int64) * len(run)], axis=1))
        before += (int(run.max(initial=-1)) + 1) * len(run)
    return out
