"""The pose solved from the photos' steps, measured on the part's lines near it.

Each step is fitted to the pixels (`image.profile`), first where it is seen, then on the line itself; the pose follows
by a regression with errors common to each edge (`locate.refine.regression`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, quantile
from cadcam.fit.grouped import GroupedFit
from cadcam.geometry.rigid import Rigid
from cadcam.locate.evidence import Evidence, PoseEvidence, moved_by_cameras, rows_of
from cadcam.locate.freedom import Freedom
from cadcam.locate.lines.bands import banded, share_beside_bands
from cadcam.locate.lines.cells import Cells, CellSize, StepOffsets, measured_steps
from cadcam.locate.lines.edges import Projected
from cadcam.locate.lines.response import bend_of, leanings, straightened
from cadcam.locate.lines.sight import Sight, nearest_steps
from cadcam.locate.refine.options import EdgeOptions
from cadcam.locate.refine.regression import Regression

CLOSE_PX = 3  # px: largest distance of the steps from the lines after the search
_ON_LINE = 0.7  # px: steps this near are fitted on the line itself
LOOSE_PX = 0.25  # common offset of edges that is rarely exceeded at a good pose
_FARTHEST_PX = 3.0  # an edge farther off is another one
_ROUNDS = (3, 8, 8, 8)  # reweightings in the first measurement, the second, and further ones until it converges
_SETTLED_PX = 0.2  # motion of nine tenths of the lines in the last step below which it has converged
_HIDDEN, _ORDINARY_PX = 0.07, 0.9  # error by what blur hides beside edges, by the blur beyond an ordinary one
# Shared errors of a body's contours, px: the largest by facets, as a surface that bulges by more was not meant to be
# smooth; and by light, which on rendered balls moves the whole limb by 0.03 to 0.07.
_BULGE_PX, _LIMB_PX = 0.25, 0.05
_EVERY = 4  # one sample in so many is tested for a nonlinear response


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolution:
    """The refined pose with what was measured, in `cells`, for its last step from `before`: x in the basis B there.

    evidence: the rows of other observations there, told: these themselves; bent (n,) px: sd of the usable samples due
    to a nonlinear response.
    """

    sights: Sequence[Sight]
    before: Rigid
    pose: Rigid
    B: Array
    places: Sequence[Projected]
    measured: Sequence[StepOffsets]
    fit: GroupedFit
    cells: Sequence[Cells]
    regression: Regression
    evidence: tuple[Array, Array, Array]
    bent: Array | None = None
    told: Sequence[Evidence] = ()

    @property
    def by_cameras(self) -> list[Array]:
        """Return the derivative (6, c) of the pose's twist by each camera's own coordinates through other observations.

        Empty where there are none, or no camera errs.
        """
        photos = [sight.photo for sight in self.sights]
        if not self.told or not any(photo.viewpoint.errors for photo in photos):
            return []
        n = sum(int(m.usable.sum()) for m in self.measured)
        return moved_by_cameras(self.told, photos, self.before, self.B @ self.fit.gain[:, n:])

    @property
    def known_poses(self) -> list[tuple[Array, Array]]:
        """Return of each pose that was evidence what cameras did to it, and its share in the pose (`uncertainty`)."""
        out, begin = [], sum(int(m.usable.sum()) for m in self.measured)
        for item in self.told:
            rows = item.rows(self.sights[item.photo].photo, self.before)[1]
            if isinstance(item, PoseEvidence) and item.from_calibration.any():
                out.append((item.from_calibration, self.B @ self.fit.gain[:, begin : begin + len(rows)] @ rows))
            begin += len(rows)
        return out

    @property
    def moved(self) -> list[Array]:
        """Return by how much (n,) px the last step moved the samples of each photo along their normals."""
        return [at.row @ (self.B @ self.fit.x) for at in self.places]

    @property
    def scatter(self) -> float:
        """Return the common offset of edges (px, root mean square), whatever their weight in the fit."""
        n = sum(int(m.usable.sum()) for m in self.measured)
        samples = np.bincount(self.fit.group[:n], minlength=len(self.fit.offset))
        offset = np.minimum(np.abs(self.fit.offset), _FARTHEST_PX)
        return float(np.sqrt(samples @ offset**2 / max(samples.sum(), 1)))

    @property
    def beside_bands(self) -> float:
        """Return the largest share of a photo's cells that lies beside bands (`locate.lines.bands`)."""
        looked = zip(self.sights, self.places, self.cells, strict=True)
        return max(share_beside_bands(*one, np.zeros(len(one[0].samples))) for one in looked)

    @property
    def hidden_px(self) -> Array:
        """Return the sd (n,) px of the usable samples due to what blur hides beside the edges.

        A shadow, a rim or a bevel within a blur or two has no step of its own but becomes part of the edge's. It shifts
        the clearest edges, which determine the pose, as far as the faint ones, whose scatter therefore does not show
        it. What an ordinary blur hides does show in the scatter of the edges.
        """
        if max((c.blurs.max(initial=0.0) for c in self.cells), default=0.0) <= _ORDINARY_PX:
            return np.zeros(sum(int(m.usable.sum()) for m in self.measured))
        blurs = [c.blurs[m.usable[c.which]] for c, m in zip(self.cells, self.measured, strict=True)]
        return np.asarray(_HIDDEN * np.sqrt(np.maximum(np.concatenate(blurs) ** 2 - _ORDINARY_PX**2, 0.0)))

    @property
    def hidden_by_blur(self) -> Array:
        """Return the covariance (k, k) of the pose due to what blur hides beside the edges, in the basis B."""
        shift = self.hidden_px
        if not shift.any():
            return np.zeros_like(self.fit.covariance)
        n, group = len(shift), self.fit.group[: len(shift)]
        moved = np.stack([np.bincount(group, row) for row in self.fit.gain[:, :n] * shift])
        return np.asarray(moved @ moved.T)

    @property
    def by_contours(self) -> Array:
        """Return the covariance (k, k) of the pose due to what all contours of a body share, in the basis B.

        They lie beyond the facets, and light near them draws all of them in, or all out. Nothing scatters by that; a
        ball seems a little farther away.
        """
        if all(sight.samples.chain.min(initial=0) >= 0 for sight in self.sights):  # no contours
            return np.zeros_like(self.fit.covariance)
        out, body = [], []
        for sight, at, measured in zip(self.sights, self.places, self.measured, strict=True):
            use, samples = measured.usable, sight.samples
            bulge_px = samples.bulge[use] * np.linalg.norm(at.row[use, :3], axis=1)
            out.append((samples.chain[use] < 0) * np.hypot(np.minimum(bulge_px, _BULGE_PX), _LIMB_PX))
            body.append(samples.part[use])
        shift, of = np.concatenate(out), np.concatenate(body)
        if not shift.any():
            return np.zeros_like(self.fit.covariance)
        moved = np.stack([np.bincount(of, row) for row in self.fit.gain[:, : len(of)] * shift])
        return np.asarray(moved @ moved.T)

    @property
    def tells_lines(self) -> bool:
        """Return whether more lines were measured than there are unknowns if each has an offset of its own."""
        lines = (len(np.unique(s.samples.run[m.usable])) for s, m in zip(self.sights, self.measured, strict=True))
        return int(sum(lines)) > int(self.B.shape[1]) + 1

    def beside_its_bands(self) -> PoseSolution:
        """Return the solution with the covariance for lines beside bands (`locate.refine.regression`).

        The pose is kept: lines that are few, or off for other reasons, would leave it to fewer still if all may be off.
        """
        there = replace(self, regression=replace(self.regression, bands=True))
        fit = there._fitted(_ROUNDS[-1]).fit
        away = fit.x - self.fit.x
        return replace(there, fit=replace(self.fit, covariance=fit.covariance + np.outer(away, away)))

    def _fitted(self, iterations: int) -> PoseSolution:
        """Return the solution refitted to its steps, with these on their lines."""
        on = self.regression.step(self.places, self.measured, self.evidence, self.B, iterations, on_lines=True)
        return replace(self, pose=self.before @ Rigid.exp(self.B @ on.x), fit=on)._doubting(self.bent)

    def _doubting(self, bent: Array | None) -> PoseSolution:
        """Return the solution with the uncertainty (n,) px of a nonlinear camera response in its covariance."""
        if bent is None:
            return self
        by_bend = self.fit.gain[:, : len(bent)] @ bent
        fit = replace(self.fit, covariance=self.fit.covariance + np.outer(by_bend, by_bend))
        return replace(self, fit=fit, bent=bent)


def solved(
    sights: Sequence[Sight],
    pose: Rigid,
    freedom: Freedom,
    evidence: Sequence[Evidence],
    options: EdgeOptions,
    *,
    bands: bool = False,
    lines: bool = False,
) -> PoseSolution:
    """Return the pose from steps measured first where they are seen near the lines, then on the lines themselves.

    Each round measures the steps near the latest pose and moves the pose to them, until hardly any line moves. bands:
    whether cells model bands beside the lines, which the model lacks (`locate.lines.bands`). lines: whether lines have
    errors like those beside bands (`locate.refine.regression`). Raises `DegenerateGeometry` where the steps do not
    determine the pose.
    """
    size = CellSize(0.5 * options.step_px, options.reach_px, options.room_px)
    places = [s.project(pose) for s in sights]
    each = list(zip(sights, places, strict=True))
    where = [nearest_steps(s, at, half_length=size.half_length, reach=CLOSE_PX) for s, at in each]
    cells = [Cells.of(s, at, size, where=w) for (s, at), w in zip(each, where, strict=True)]
    regression, on_lines = Regression.of(sights, options, bands=lines), False
    for number, iterations in enumerate(_ROUNDS):
        if bands and number:  # before the second round, lines are too far off to tell bands from other lines' steps
            cells, measured = _steps_beside_bands(sights, places, cells, where, anew=number == 1)
        else:
            measured = _steps(sights, places, cells, where, again=number > 0)
        other = rows_of(evidence, [s.photo for s in sights], pose)
        B = freedom.at(pose)
        fit = regression.step(places, measured, other, B, iterations, on_lines=on_lines)
        moved = pose @ Rigid.exp(B @ fit.x)
        last = PoseSolution(sights, pose, moved, B, places, measured, fit, cells, regression, other, told=evidence)
        moved_px = last.moved
        if number and quantile(np.abs(np.concatenate(moved_px)), 0.9) < _SETTLED_PX:
            break
        pose, on_lines = last.pose, fit.between < LOOSE_PX
        where = [_left(m, px) for m, px in zip(measured, moved_px, strict=True)]
        places = [s.project(pose) for s in sights]
    return _unbent(last, iterations)


def _steps(
    sights: Sequence[Sight], places: Sequence[Projected], cells: Sequence[Cells], where: Sequence[Array], *, again: bool
) -> list[StepOffsets]:
    """Return the steps of each photo in its cells; where (N,) px along the normals: approximate places of the steps.

    again: whether lines have moved since the cells were laid out; if not, these know their sums over the pixels.
    """
    each = zip(sights, places, cells, where, strict=True)
    return [measured_steps(s, at, c, w, sums=None if again else c.first) for s, at, c, w in each]


def _steps_beside_bands(
    sights: Sequence[Sight],
    places: Sequence[Projected],
    cells: Sequence[Cells],
    where: Sequence[Array],
    *,
    anew: bool,
) -> tuple[list[Cells], list[StepOffsets]]:
    """Return cells without bands, and the steps measured in those with bands; where, anew: as in `bands.banded`."""
    looked = [banded(*one, anew=anew) for one in zip(sights, places, cells, where, strict=True)]
    each = zip(sights, places, looked, where, strict=True)
    measured = [measured_steps(s, at, with_bands, w, sums=sums) for s, at, (_, with_bands, sums), w in each]
    return [plain for plain, _, _ in looked], measured


def _unbent(last: PoseSolution, iterations: int) -> PoseSolution:
    """Return the solution without what a nonlinear camera response (gamma) does to the steps, where that shows.

    The response is estimated from every `_EVERY`-th step. Contours of round surfaces are no evidence of it, as light
    shifts them as well, all to the inside. iterations: reweightings of the final fit.
    """
    sights, places, measured, blurs = last.sights, last.places, last.measured, [c.blur for c in last.cells]
    used = [np.flatnonzero(m.usable) for m in measured]
    tested = [np.flatnonzero(s.samples.chain[u] >= 0)[::_EVERY] for s, u in zip(sights, used, strict=True)]
    few = [u[k] for u, k in zip(used, tested, strict=True)]
    ends = np.cumsum([len(u) for u in used])
    groups = np.split(last.fit.group[: ends[-1]], ends[:-1])
    if not any(len(k) for k in few):
        return last
    bend = bend_of(
        last.fit,
        J=np.concatenate([at.row[k] for at, k in zip(places, few, strict=True)]) @ last.B,
        lean=np.concatenate([leanings(*one) for one in zip(sights, places, few, blurs, strict=True)]),
        bright=np.concatenate([np.sign(m.contrast[k]) for m, k in zip(measured, few, strict=True)]),
        group=np.concatenate([g[k] for g, k in zip(groups, tested, strict=True)]),
    )
    if bend is None:
        return last
    leans = [leanings(*one) for one in zip(sights, places, used, blurs, strict=True)]
    bent = bend.sd * np.concatenate(leans)
    if bend.excess == 0:
        return last._doubting(bent)
    return replace(last, measured=straightened(measured, leans, bend), bent=bent)._fitted(iterations)


def _left(measured: StepOffsets, moved: Array) -> Array:
    """Return where to fit the steps once the lines have moved: on the lines, except for edges far from them."""
    left = np.where(measured.usable, measured.offset, 0.0) - moved
    return np.where(np.abs(left) < _ON_LINE, 0.0, left) * measured.usable
