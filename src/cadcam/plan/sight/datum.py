"""What one camera tells of features that are judged relative to a datum in the same pictures, as `cadcam verify` does.

Edges are drawn, weighed and adjusted as there (`cadcam.verify.adjustment`): only their offsets are still unknown. The
pose xi is fitted to the datum's edges other than the feature's own, the feature's displacement u to its own against
that pose: with N = G^T V^-1 G and M = J^T V^-1 J (of the datum),

    u = (N + 1/s^2)^-1 G^T V^-1 (y - J xi),    xi = M^-1 J^T V^-1 y,    s: what is expected of u (`UNSEEN_PX`).

V is the errors of each edge by itself. Errors of cameras, C of unit variance, move the feature and the datum together;
what the pose does not follow of them remains in u. All sums add up over cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.edges import EdgeKind
from cadcam.camera.optics import Optics
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.plan.scene.layout_scene import LayoutScene, Seeing
from cadcam.plan.sight.surroundings import Surroundings
from cadcam.plan.uncertainty.evidence import Together, inverse, symmetric
from cadcam.plan.uncertainty.finding import Finder, defocus
from cadcam.verify.adjustment.datum_fit import Adjustment
from cadcam.verify.adjustment.refits import Normals
from cadcam.verify.adjustment.scatter import EdgeNoise
from cadcam.verify.edges.association import searchable
from cadcam.verify.edges.sightlines import STEP_PX, Sightlines, lines_in_view
from cadcam.verify.edges.step_fit import ROOM_PX
from cadcam.verify.tolerances.tolerance import Selection

USUAL_PX = 0.02  # error common to each edge, where none is stated: of parts as drawn (benchmarks/edge_errors.py)


@dataclass(frozen=True, slots=True, eq=False)
class DatumEvidence:
    """What a camera tells of D features in P poses; r: errors of the camera, of unit variance.

    own (P, D, 3, 9 + r): G^T V^-1 (G, J, C) of the feature's edges; fitted (P, D, 6, 6 + r): J^T V^-1 (J, C) of the
    datum's others. length_px (P, D): of the feature's edges that are seen.
    """

    own: Array
    fitted: Array
    length_px: Array

    def of(self, number: Longs) -> DatumEvidence:
        """Return that of some of the features."""
        return DatumEvidence(self.own[:, number], self.fitted[:, number], self.length_px[:, number])


@dataclass(frozen=True, slots=True, eq=False)
class Judging:
    """The part, its datum, and D features that are judged: their numbers among those of the scene, and their edges."""

    part: Part
    datum: tuple[Selection, ...]
    numbers: tuple[int, ...]
    features: tuple[Selection, ...]

    @classmethod
    def of(cls, scene: LayoutScene) -> Judging | None:
        """Return what is judged in a scene; None without a datum. Raises as `Selection.check`."""
        if not scene.datum:
            return None
        part = Part.of(scene.part)
        for chosen in scene.datum:
            chosen.check(part.scene)
        judged = [scene.features[i].selection for i in scene.judged]
        return cls(part, scene.datum, scene.judged, tuple(s for s in judged if s is not None))

    def seen_from(
        self,
        view: Viewpoint,
        optics: Optics | None,
        poses: Sequence[Rigid],
        surroundings: Surroundings,
        *,
        finder: Finder,
        seeing: Seeing,
    ) -> DatumEvidence:
        """Return what a camera tells of the features in some poses (world_from_part)."""
        each = []
        for pose in poses:
            lines = self._lines(view, optics, pose, surroundings, finder, seeing)
            z = (view.camera_from_world @ pose @ lines.p)[:, 2]
            sigma = 1 / np.sqrt(finder.per_px(finder.blur(optics, z)) * STEP_PX)
            errors = EdgeNoise.of(sigma, lines.edge, lines.along, finder.floor_px or USUAL_PX)
            datum = np.any([self._held(chosen, lines) for chosen in self.datum], axis=0)
            y = np.zeros(len(lines))
            each.append(self._sums(lines, Adjustment(y, lines.by_pose, lines.by_cause, errors, datum)))
        return DatumEvidence(*(np.stack([getattr(e, n) for e in each]) for n in DatumEvidence.__slots__))

    def _held(self, chosen: Selection, lines: Sightlines) -> Mask:
        return chosen.holds(lines.part, lines.chain, lines.kind, lines.p, chosen.bodies(self.part.scene))

    def _lines(
        self,
        view: Viewpoint,
        optics: Optics | None,
        pose: Rigid,
        surroundings: Surroundings,
        finder: Finder,
        seeing: Seeing,
    ) -> Sightlines:
        """Return the places whose steps can be fitted to a sharp picture; contours, which tell little, left out."""
        lines, _ = lines_in_view(self.part, [view], pose)
        world = pose @ lines.p
        z = (view.camera_from_world @ world)[:, 2]
        use = searchable(lines, [view.camera]) & (lines.room >= ROOM_PX + 1.5 * finder.blur(optics, z))
        use &= (lines.kind != EdgeKind.CONTOUR) & (defocus(optics, z) <= seeing.blur_px)
        use[use] = ~surroundings.behind_obstacles(
            np.tile(view.camera_from_world.origin, (int(use.sum()), 1)), world[use]
        )
        return lines.select(use)

    def _sums(self, lines: Sightlines, fit: Adjustment) -> DatumEvidence:
        normals = Normals.of(fit.sums_of(fit.datum).normal(fit.errors.tau))
        own, fitted, length = [], [], []
        for chosen in self.features:
            rows = self._held(chosen, lines)
            G = lines.by_point[rows]
            own.append(fit.errors.of_rows(rows).white(G).T @ np.column_stack([G, fit.J[rows], fit.C[rows]]))
            fitted.append(np.delete(normals.total(fit.errors.edge[rows]), 6, axis=1))
            length.append(STEP_PX * rows.sum())
        return DatumEvidence(np.array(own), np.array(fitted), np.array(length, np.float64))


def together_from_datum(evidence: Sequence[DatumEvidence], columns: Sequence[Longs], n: int, known: Array) -> Together:
    """Return what cameras tell together of features relative to the datum, as `together` of (P * D) features.

    columns: of each camera, which of n errors of unit variance its own r are. known (P * D, 3, 3): what is known beside
    the pictures. NaN where the pictures do not show a feature in all directions, or do not hold the part by its datum.
    """
    N, NJ, NC = np.split(_added([e.own for e in evidence], 9, columns, n), [3, 9], axis=-1)
    M, MC = np.split(_added([e.fitted for e in evidence], 6, columns, n), [6], axis=-1)
    C = inverse(symmetric(N + known), np.trace(N + known, axis1=-2, axis2=-1))
    by_pose, pose = C @ NJ, _fitted_pose(M)
    through_pose = symmetric(by_pose @ pose @ np.swapaxes(by_pose, -1, -2))
    S = C @ NC - by_pose @ pose @ MC
    covariance = C + through_pose + S @ np.swapaxes(S, -1, -2)
    return Together(symmetric(covariance), symmetric(C @ N @ C) + through_pose, S)


def alone_from_datum(evidence: Sequence[DatumEvidence], cameras: int) -> Array:
    """Return information (V, P, D, 3, 3) of each camera alone, as if a set of so many knew the pose like mean ones.

    It is for a search, which adds it up: in truth the datum's error is common to all cameras of a set.
    """
    M = np.sum([e.fitted[..., :6] for e in evidence], axis=0) * (min(cameras, len(evidence)) / len(evidence))
    pose = _fitted_pose(M)
    if np.isnan(pose).any():
        raise BadValue("datum", "too few edges to hold the part, in all cameras together", "more of the part in it")
    root = np.linalg.cholesky(pose)
    out = []
    for e in evidence:
        N, NJ, NC = np.split(e.own, [3, 9], axis=-1)
        K = np.concatenate([NC - NJ @ pose @ e.fitted[..., 6:], NJ @ root], axis=-1)  # N times the errors' effects
        Kt = np.swapaxes(K, -1, -2)
        inner = np.eye(K.shape[-1]) + Kt @ np.linalg.pinv(N, hermitian=True) @ K
        out.append(symmetric(N - K @ np.linalg.solve(inner, Kt)))
    return np.array(out)


def _added(sums: Sequence[Array], m: int, columns: Sequence[Longs], n: int) -> Array:
    """Return the sums (P * D, k, m + n) of cameras' (P, D, k, m + r), errors that are the same in one column."""
    out = np.zeros((*sums[0].shape[:3], m + n))
    for each, own in zip(sums, columns, strict=True):
        out[..., :m] += each[..., :m]
        out[..., m + own] += each[..., m:]
    return out.reshape(-1, *out.shape[2:])


def _fitted_pose(M: Array) -> Array:
    """Return the covariance (..., 6, 6) of poses by their information, of mm and rad; NaN where it is singular."""
    scale = np.sqrt(np.maximum(np.diagonal(M, axis1=-2, axis2=-1), 1e-300))
    both = scale[..., :, None] * scale[..., None, :]
    return np.asarray(inverse(symmetric(M / both), np.full(M.shape[:-2], 6.0)) / both)
