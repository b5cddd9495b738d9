"""Deviations from offsets: which displacements the photos show, their size and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.edge_kind import EdgeKind
from cadcam.errors import DegenerateGeometry
from cadcam.geometry.plane import axes_across
from cadcam.verify.adjustment.alarms import either, tail_probability
from cadcam.verify.adjustment.datum_fit import CAUSES, Adjustment, Estimate, FittedPose
from cadcam.verify.adjustment.following import BodyLines, following, turning
from cadcam.verify.adjustment.refits import Refits
from cadcam.verify.adjustment.scatter import EdgeNoise, EdgeSums, improbability, white_scale
from cadcam.verify.edges.rims import Rims
from cadcam.verify.edges.sightlines import STEP_PX, Sightlines, curvature, erring_alike
from cadcam.verify.edges.survey import Survey

SEEN_PX = 0.5  # largest sd, in px, of a direction of displacement that counts as seen
UNSEEN_PX = 4.0  # prior sd, in px, of a displacement in directions not seen, and of turns that are not judged
# The same by which a displaced body's turn moves its rim. It is as large as those that matter: if larger turns are
# expected, one that is seen but small looks less probable than a shift with edges that err.
_TURNED_PX = 1.0
OPEN_PX = 1e3  # the same of what is wholly unknown
_USUAL_PX = 0.01  # common error of an edge in most photos, and the least: long straight edges tell less, others have it
DISAGREE = 9.0  # misfit from which edges contradict a common displacement
_BLIND = 1e-9  # information on a rotation, relative to the largest, that counts as none
# A step is measured in a straight cell, whose edge bends by half of this over its radius on the average; rims of 10 to
# 30 px are measured too large by a quarter of it to all of it.
_CELL_BENT = STEP_PX**2 / 12
STATION_PX = 24.0  # length of the pieces of an edge that are evaluated separately


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """A displacement in the seen directions `basis` (3, m): estimate, probability for a body in place, number of edges.

    It is that of the middle of the places, should the body turn. misfit: of the edges with a body that does not. known:
    whether its size is; if not, the photos may still show that there is one, and the basis is the direction that they
    measure best.
    """

    basis: Array
    estimate: Estimate
    p_value: float
    edges: int
    misfit: float = 1.0
    known: bool = True

    @property
    def vector(self) -> Array:
        """Return the displacement (3,) mm in the part frame, zero in directions not seen."""
        return np.asarray(self.basis @ self.estimate.value)


@dataclass(frozen=True)
class MeasuredEdges:
    """The places where the photos show the part's edges, their errors, and the pose fitted to the datum among them.

    body, lever, mate (N,), ground (N, 3) and members as in `Survey`; eye (3,): the camera's place in the part frame if
    one photo sees the part, None if several do; noise_scale: see `white_scale`; tau_px: common error of an edge;
    own_noise: errors of edges, estimated without that one; sums: of all places, which no common error changes. cameras
    (N, m): errors of cameras that are fitted where the common error is estimated; with_cameras: the sums with them.
    rims: the places as those of circles whose diameter is asked; found: displacements of features computed before, by
    number.
    """

    lines: Sightlines
    body: Longs
    members: tuple[Mask, ...]
    adjustment: Adjustment
    lever: Array
    mate: Longs
    ground: Array
    eye: Array | None
    noise_scale: float
    tau_px: float
    own_noise: EdgeNoise
    sums: EdgeSums
    cameras: Array
    with_cameras: EdgeSums
    rims: Rims
    found: dict[int, Displacement | None] = field(default_factory=dict)

    @classmethod
    def of(cls, survey: Survey, used: Mask, datum: Mask, freedom: Array) -> MeasuredEdges:
        """Return the measurement of the places `used` (N,), with the pose fitted to those also in `datum` (N,)."""
        rows = used & survey.matched.measured & survey.usable
        lines, offset = survey.lines.select(rows), survey.matched.offset[rows]
        sigma = survey.matched.sigma[rows]
        scale = white_scale(offset, EdgeNoise.of(sigma, lines.edge, lines.along, 0.0))
        alike = erring_alike(lines, datum[rows])
        noise = EdgeNoise.of(sigma * scale, *alike, 0.0).with_more(survey.matched.common[rows])
        noise = replace(noise, apart=survey.matched.apart[rows])
        members = tuple(m[rows] for m in survey.members)
        adjustment = Adjustment(offset, lines.by_pose, lines.by_cause, noise, datum[rows], freedom)
        cameras = adjustment.by_cameras()
        alone, with_cameras = adjustment.sums_beside(cameras, np.ones(len(offset), bool))
        lever, mate, ground = survey.lever[rows], survey.mate[rows], survey.ground[rows]
        own = lines, survey.body[rows], members, adjustment, lever, mate, ground, survey.eye(rows)
        out = cls(*own, scale, 0.0, noise, alone, cameras, with_cameras, survey.rims.select(rows))
        return out.fitted_to(datum[rows])

    def refits(self) -> Refits:
        """Return what many fits to some of the places have in common, for `fitted_to`."""
        return Refits(self.sums, self.with_cameras, self.own_noise.tau)

    def fitted_to(self, datum: Mask, refits: Refits | None = None) -> MeasuredEdges:
        """Return the same with the pose, and the common error of edges, fitted to these places (n,).

        Edges of which all places are among them have sums that are known; few are left in part.
        """
        refits, noise = self.refits() if refits is None else refits, self.own_noise
        have = np.bincount(noise.edge, datum, minlength=noise.edges)
        whole = have == np.bincount(noise.edge, minlength=noise.edges)
        some = datum & ~whole[noise.edge]
        part, drawn = self.sums.of_none(), self.with_cameras.of_none()
        if some.any():
            part, drawn = self.adjustment.sums_beside(self.cameras, some, every=False)
        taken = whole, np.unique(noise.edge[some])
        tau = max(refits.common_error(*taken, drawn, usual=_USUAL_PX), _USUAL_PX) if datum.any() else 0.0
        noise = replace(noise, tau=np.hypot(noise.tau, tau))
        fitted = replace(self.adjustment, errors=noise, datum=datum, known=refits.fitted(*taken, part, tau))
        return replace(self, adjustment=fitted, tau_px=tau, found={})

    @property
    def dof(self) -> float:
        """Return the degrees of freedom of tau: two per edge of the datum, less those of the pose."""
        edges = len(np.unique(self.lines.edge[self.adjustment.datum]))
        return float(max(2 * edges - self.adjustment.freedom.shape[1], 1))

    def pose_without(self, rows: Mask) -> FittedPose | None:
        """Return the pose fitted without the edges of these places; None where the rest does not determine it."""
        try:
            return self.adjustment.pose(without=rows)
        except DegenerateGeometry:
            return None

    def directions(self, rows: Mask) -> Array:
        """Return the directions (3, m), orthonormal in the part frame, in which a shift of these places is seen.

        With one photo, none along the line of sight: there only the size of the feature's picture changes.
        """
        G = self.lines.by_point[rows]
        across = np.eye(3) if self.eye is None else _perpendicular(self.axis(rows)[:, None])
        w, V = np.linalg.eigh(self.adjustment.information(rows, G @ across))
        px_per_mm = np.median(np.linalg.norm(G, axis=1))
        seen = w > (px_per_mm / SEEN_PX) ** 2
        return np.asarray(across @ V[:, seen][:, ::-1])

    def moved(self, number: int) -> Displacement | None:
        """Return a feature's displacement; None where the edges do not determine it."""
        if number not in self.found:
            self.found[number] = self.displacement(self.members[number])
        return self.found[number]

    def displacement(self, rows: Mask, *, along: Array | None = None, apart: Mask | None = None) -> Displacement | None:
        """Return the common displacement of the places; along (3, m): in those directions alone. None: undetermined.

        apart (n,): places to whose edges the pose is not fitted either, such as the others of the same body.

        The estimate allows for feet that need not follow (`cadcam.verify.adjustment.following`), for edges that
        disagree, and for displacements along the line of sight. The probability, for a body in place, is that of the
        edges' common motion and of that estimate: feet that stay hide from the first what the second sees.
        """
        told = self._told(rows, along, rows if apart is None else rows | apart)
        if told is None:
            return None
        basis, pose = told
        p_value = self._p_value(rows, basis, pose)
        if along is not None:
            estimate, misfit = self._followed(rows, basis, pose)
            best, known = self._best_told(rows, estimate)
            return Displacement(basis @ best, estimate.along(best.T), p_value, self._edge_count(rows), misfit, known)
        if not basis.shape[1]:
            return None
        every = np.column_stack([basis, _perpendicular(basis)])
        estimate, misfit = self._followed(rows, every, pose)
        p_value = either(p_value, tail_probability(estimate.value, estimate.covariance, self.dof))
        plane = self._leaning(rows, basis, every @ estimate.covariance @ every.T)
        best, known = self._best_told(rows, estimate.along(plane.T @ every))
        told_there = estimate.along(best.T @ plane.T @ every)
        return Displacement(plane @ best, told_there, p_value, self._edge_count(rows), misfit, known)

    def p_value(self, rows: Mask) -> float:
        """Return the probability of offsets like those of these places if they are in place; nan: undetermined."""
        told = self._told(rows, None, rows)
        return float("nan") if told is None else self._p_value(rows, *told)

    def _told(self, rows: Mask, along: Array | None, apart: Mask) -> tuple[Array, FittedPose] | None:
        """Return the directions (3, m) of displacement that these places measure, and the pose without those apart."""
        if not rows.any():
            return None
        basis = self.directions(rows) if along is None else np.asarray(along, np.float64)
        pose = self.pose_without(apart)
        if pose is None or not np.abs(self.lines.by_point[rows] @ basis).max(initial=0.0) > 0:
            return None
        return basis, pose

    def _p_value(self, rows: Mask, basis: Array, pose: FittedPose) -> float:
        """Return the probability for a body in place, which is not displaced in unseen directions either."""
        shown, grown = self.lines.by_point[rows] @ basis, self._growth(rows)
        if not grown.shape[1]:
            in_place = self.adjustment.estimate(rows, shown, pose)
            return tail_probability(in_place.value, in_place.covariance, self.dof)
        mm = self.unseen_mm(rows)  # of its size nothing is said: it may be another, as if that were unseen
        shift = OPEN_PX / UNSEEN_PX * mm * np.eye(basis.shape[1])
        in_place = self.adjustment.estimate(rows, np.column_stack([shown @ shift, mm * grown]), pose, prior=1.0)
        in_place = in_place.along(np.eye(*np.add(basis.shape[1], (0, 1))))
        return tail_probability(in_place.value, in_place.covariance, self.dof)

    def _growth(self, rows: Mask) -> Array:
        """Return how far (n, g), px/mm, places move across their edges as the radius grows; g: 1 for circles, else 0.

        Where not all of them are of circles whose diameter is asked, they have their size.
        """
        rims = self.rims.select(rows)
        grown = rims.growth(self.lines.by_point[rows])
        return grown[:, None] if (rims.radius > 0).all() else np.zeros((len(grown), 0))

    def _followed(self, rows: Mask, basis: Array, pose: FittedPose) -> tuple[Estimate, float]:
        """Return the displacement along a basis (3, m), and the misfit of a body that does not turn.

        It allows for feet that need not follow, for a turn, and for another size of circles whose diameter is asked.
        """
        body, mm = self.body_lines(rows), self.unseen_mm(rows)
        rim = float(np.linalg.norm(body.arms, axis=1).max())
        turns = _TURNED_PX / UNSEEN_PX * mm / rim * np.eye(3) if rim > 0 else np.zeros((3, 0))
        found, misfit = following(self.adjustment, rows, body, pose, basis=basis, prior_mm=mm, turns=turns)
        if body.grows.any():
            motion = body.motions(basis, np.zeros((3, 0)), 1.0) @ found.value
            straight = self.straightened(self.adjustment, rows, motion)
            found, misfit = following(straight, rows, body, pose, basis=basis, prior_mm=mm, turns=turns)
            bent = following(self.bent(straight, rows), rows, body, pose, basis=basis, prior_mm=mm, turns=turns)[0]
            found = with_bends(found, bent)
        return found.along(np.eye(basis.shape[1], len(found.value))), misfit

    def straightened(self, adjustment: Adjustment, rows: Mask, motion: Array) -> Adjustment:
        """Return offsets as circles at these places would have them by a motion (6 + g,) if they were their tangents.

        That is what the adjustment takes them for: a hole 6 px off, or an oblique one too large, otherwise looks too
        small.
        """
        offset, rims = adjustment.offset.copy(), self.rims.select(rows)
        offset[rows] -= rims.beyond_tangents(self.lines.by_point[rows], motion[:3], float(motion[6:].sum()))
        return replace(adjustment, offset=offset)

    def body_lines(self, rows: Mask) -> BodyLines:
        """Return how these places move with the body that they are all of."""
        moves = self.lines.by_point[rows], self.lever[rows], self.ground[rows]
        return BodyLines(*moves, self.lines.p[rows], self._growth(rows))

    def _edge_count(self, rows: Mask) -> int:
        return len(np.unique(self.lines.edge[rows]))

    def _leaning(self, rows: Mask, basis: Array, covariance: Array) -> Array:
        """Return the directions of a basis (3, m), tilted to the line of sight at which each is measured.

        A displacement towards the camera, which is not seen, looks like one across the line of sight through the body's
        middle if that is measured at one end of the body; across that end's own line of sight it does not.
        """
        if self.eye is None:
            return basis
        axis, sight = self.axis(rows), self.lines.p[rows] - self.eye
        extent = np.linalg.norm(np.cross(sight, axis), axis=1).max() / np.linalg.norm(sight, axis=1).mean()
        lean = basis.T @ covariance @ axis / (axis @ covariance @ axis)
        lean *= min(1.0, extent / max(float(np.linalg.norm(lean)), 1e-12))
        return np.asarray(np.linalg.qr(basis - np.outer(axis, lean))[0])

    def _best_told(self, rows: Mask, found: Estimate) -> tuple[Array, bool]:
        """Return the directions (m, k) in which an estimate is accurate enough to count as seen, and whether any is.

        Where none is, the most accurate one.
        """
        w, V = np.linalg.eigh(found.covariance)
        sure = int((w < (SEEN_PX * float(np.median(self.lines.mm_per_px[rows]))) ** 2).sum())
        return np.asarray(V[:, : max(sure, 1)]), sure > 0

    def unseen_mm(self, rows: Mask) -> float:
        """Return the standard deviation (mm) of a displacement that photos do not show."""
        return UNSEEN_PX * float(np.median(self.lines.mm_per_px[rows]))

    def improbability(self, body: int) -> float:
        """Return how improbable the datum's offsets, and a body's, are if the body is displaced.

        In the sense of `cadcam.verify.adjustment.scatter`. Bodies that stand on it are then not measured by their feet,
        nor is the body by its own.
        """
        its = self.body == body
        rows = self.adjustment.datum | its | (self.mate == body)
        mm = self.unseen_mm(rows)
        slid = np.where(its | (self.mate == body), np.abs(self.lever) * mm, 0.0)[rows]
        K = np.where(its[:, None], self.lines.by_point * mm, 0.0)[rows]
        noise = self.adjustment.errors.of_rows(rows).with_more(slid)
        return improbability(self.adjustment.offset[rows], noise, self.adjustment.J[rows] @ self.adjustment.freedom, K)

    def turn(self, rows: Mask) -> tuple[float, float, Array]:
        """Return the rotation (rad) about the line of sight through the places' middle, its sigma, that axis (3,).

        With one photo, what turns about other axes and a shift along the line of sight may feign is part of sigma. nan
        where the edges do not determine the rotation.
        """
        axis = self.axis(rows)
        found = self.turns(rows, axis[:, None])
        if found is None:
            return float("nan"), float("nan"), axis
        return float(found[1].value[0]), float(np.sqrt(found[1].covariance[0, 0])), axis

    def turns(self, rows: Mask, about: Array) -> tuple[Array, Estimate] | None:
        """Return axes (3, m) among those that `about` (3, n) spans, and the rotations (rad) about them that edges show.

        The axes pass through the places' middle. About those left out the edges may turn unnoticed. None: they show no
        rotation.
        """
        basis, pose = self.directions(rows), self.pose_without(rows)
        if pose is None or not basis.shape[1]:
            return None
        G, lever = self.lines.by_point[rows], self._levers(rows, about)
        size, most = float(np.abs(lever).max(initial=0.0)), np.linalg.norm(G, axis=1).max()
        if size == 0:
            return None
        # In px/mm, like the displacements that are estimated with it; so the conditioning of all can be judged.
        shift, turned = G @ basis, lever / size * most
        m = basis.shape[1]
        known = self.adjustment.information(rows, np.column_stack([shift, turned]))
        alone = known[m:, m:] - known[m:, :m] @ np.linalg.solve(known[:m, :m], known[:m, m:])  # the shift unknown
        w, V = np.linalg.eigh(alone)
        V = V[:, w > _BLIND * np.linalg.eigvalsh(known)[-1]]
        if not V.shape[1]:
            return None
        return about @ V, self._turned(rows, basis, about @ V, _perpendicular(about), pose)

    def _levers(self, rows: Mask, about: Array) -> Array:
        """Return how far (N, n), px/rad, places move across their edges in turns about axes (3, n) in their middle."""
        body = self.body_lines(rows)
        motions = body.motions(np.zeros((3, 0)), about, 0.0)[:, : about.shape[1]]
        return body.moved_by(motions, np.zeros(len(body.p), bool))

    def _turned(self, rows: Mask, basis: Array, about: Array, beside: Array, pose: FittedPose) -> Estimate:
        """Return the turns (rad) about axes (3, n), of a body whose shift along a basis (3, m) is unknown, too.

        beside: axes about which it may turn as well: by one photo, by which they are not judged, by a few pixels; so
        much may it be shifted along other directions. A tilted body looks turned by a few edges: a plate that tips over
        its long edge, say.
        """
        shown, other = self.lines.by_point[rows] @ basis, UNSEEN_PX if self.eye is not None else OPEN_PX
        shifts = [basis * OPEN_PX / np.abs(shown).max(axis=0), _perpendicular(basis) * self.unseen_mm(rows)]
        turns = [
            axes * px / np.maximum(np.abs(self._levers(rows, axes)).max(axis=0), 1e-300)
            for axes, px in ((about, OPEN_PX), (beside, other))
        ]
        body, one_photo = self.body_lines(rows), self.eye is not None
        motions = body.motions(np.column_stack(shifts), np.column_stack(turns), self.unseen_mm(rows))
        found = turning(self.adjustment, rows, body, pose, motions=motions, upright=one_photo)
        return found.along(about.T @ motions[3:6])

    def grown(self, rows: Mask, axis: Array) -> tuple[Estimate, float] | None:
        """Return by how much (mm) the diameter of these places' circles, about an axis (3,), exceeds the CAD's.

        Also the scatter along edges that this leaves, over what is expected (variances): much where they are mistaken.
        The feature may be displaced as well, by one photo across its axis alone, and turned by a few px. None: its
        edges do not show it.
        """
        pose, body = self.pose_without(rows), self.body_lines(rows)
        if pose is None or not body.grows.any():
            return None
        mm, across = self.unseen_mm(rows), np.stack(axes_across(axis), axis=1)
        levers = np.abs(self._levers(rows, across)).max(axis=0)
        turns = across * UNSEEN_PX / np.maximum(levers, 1e-300)
        open_mm = OPEN_PX / UNSEEN_PX * mm
        motions = body.motions(mm * (np.eye(3) if self.eye is None else across), turns, open_mm)
        inside = self.rims.inside * self.rims.growth(self.lines.by_point)
        circles = replace(self.adjustment, offset=self.adjustment.offset - inside)
        found = turning(circles, rows, body, pose, motions=motions, upright=False, enlarged=True)
        straight = self.straightened(circles, rows, motions @ found.value)
        found = turning(straight, rows, body, pose, motions=motions, upright=False, enlarged=True)
        by_motion = body.moved_by(motions, np.zeros(len(body.p), bool)) @ found.value
        left = straight.offset[rows] - self.adjustment.J[rows] @ pose.xi - by_motion
        within, runs = self.adjustment.errors.of_rows(rows).about_lines(left)
        diameter = found.along(2 * motions[6:])
        bent = 2 * self._bent_px(rows) / float(np.median(np.abs(body.grows)))
        return replace(diameter, edges=diameter.edges + bent**2), within / max(len(left) - runs, 1)

    def _bent_px(self, rows: Mask) -> float:
        """Return the standard deviation (px) of steps in cells in which edges bend, on the average of these places."""
        lines = self.lines.select(rows & (self.lines.kind != EdgeKind.CONTOUR))
        return _CELL_BENT * float(curvature(lines).sum()) / max(len(lines), 1)

    def bent(self, adjustment: Adjustment, rows: Mask) -> Adjustment:
        """Return offsets with the error, 1 sigma, of steps in cells in which these circles bend: all look too large."""
        offset, lines = adjustment.offset.copy(), self.lines.select(rows)
        out = np.sign(self.rims.select(rows).growth(lines.by_point))
        offset[rows] += _CELL_BENT * curvature(lines) * out
        return replace(adjustment, offset=offset)

    def axis(self, rows: Mask) -> Array:
        """Return the mean line of sight (3,) of the places, away from the camera, in the part frame."""
        if self.eye is not None:
            mean = (self.lines.p[rows] - self.eye).mean(axis=0)
            return np.asarray(mean / np.linalg.norm(mean))
        _, V = np.linalg.eigh(self.lines.by_point[rows].T @ self.lines.by_point[rows])
        return np.asarray(V[:, 0])

    def across(self, rows: Mask, *, pose: FittedPose | None) -> tuple[float, float, Array]:
        """Return the mean deviation (mm) of places of one edge across it, sigma, and the variances (4,) of `CAUSES`."""
        if pose is None or not rows.any():
            return float("nan"), float("nan"), np.full(len(CAUSES), np.nan)
        variances, value = self.adjustment.mean(rows, np.linalg.norm(self.lines.by_point[rows], axis=1), pose)
        return value, float(np.sqrt(variances.sum())), variances

    def across_px(self, rows: Mask, pose: FittedPose) -> tuple[float, float]:
        """Return the mean offset (px) of places of one edge across it, and its sigma."""
        value, sigma, _ = self.across(rows, pose=pose)
        px = 1.0 / float(np.median(self.lines.mm_per_px[rows]))
        return value * px, sigma * px

    def farthest_px(self, rows: Mask, pose: FittedPose) -> tuple[float, float]:
        """Return mean offset (px) and sigma of the edge of these places that is farthest off, in sigmas."""
        each = [rows & (self.lines.edge == e) for e in np.unique(self.lines.edge[rows])]
        return max((self.across_px(edge, pose) for edge in each), key=lambda found: abs(found[0]) / found[1])

    def stations(self, rows: Mask, *, pose: FittedPose | None) -> Array:
        """Return (s, 7) of pieces about `STATION_PX` long: along the edge, px, then what `across` tells of each."""
        out = []
        piece = np.floor(self.lines.along / STATION_PX).astype(np.int64)
        for number in np.unique(piece[rows]):
            mine = rows & (piece == number)
            value, sigma, variances = self.across(mine, pose=pose)
            out.append((float(self.lines.along[mine].mean()), value, sigma, *variances))
        return np.array(out).reshape(-1, 3 + len(CAUSES))


def with_bends(found: Estimate, bent: Estimate) -> Estimate:
    """Return an estimate whose covariance holds the error by which one of offsets that are `bent` differs from it."""
    off = bent.value - found.value
    return replace(found, edges=found.edges + np.outer(off, off))


def of_known_size(moved: Displacement | None) -> Displacement | None:
    """Return a displacement if its size is known."""
    return moved if moved is not None and moved.known else None


def _perpendicular(basis: Array) -> Array:
    """Return orthonormal directions (3, 3 - m) perpendicular to those of a basis (3, m)."""
    return np.asarray(np.linalg.svd(basis)[0][:, basis.shape[1] :])
