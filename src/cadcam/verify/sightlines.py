"""Places on the part's visible edges, and all that moves their images: the part, its features, the camera's errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask
from cadcam.camera.sensitivity import project_with_sensitivity
from cadcam.camera.viewpoint import ErrorSource
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.wireframe import Polylines, Wireframe

Longs = npt.NDArray[np.int64]
STEP_PX = 4.0  # between places
_END_PX = 4.0  # of a line where other lines begin: profiles there see those too
_BORDER_PX = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Sightlines:
    """N places on visible edges, in the photos and on the part.

    q (N, 2) px where the model puts them, normal (N, 2) across the edge, p (N, 3) mm in the part frame; by_point (N, 3)
    px/mm: how the image moves along its normal when the place moves on the part; by_cause (N, r) px: how it moves with
    each of r independent unit errors of cameras and their places; along (N,) px: position along its edge, 0 in the
    edge's middle; edge (N,): its edge in its photo, 0 ...; part, kind, chain, photo (N,) as in `EdgeMatches`.
    """

    q: Array
    normal: Array
    p: Array
    by_point: Array
    by_cause: Array
    along: Array
    edge: Longs
    part: Ids
    kind: Ids
    chain: Ids
    photo: Ids

    def __len__(self) -> int:
        return len(self.q)

    def select(self, chosen: Mask | Longs) -> Sightlines:
        """Return the chosen places."""
        return replace(self, **{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    @property
    def by_pose(self) -> Array:
        """Return how the image moves along its normal with xi of world_from_part @ Rigid.exp(xi), (N, 6) px."""
        return np.concatenate([self.by_point, np.cross(self.p, self.by_point)], axis=1)

    @property
    def mm_per_px(self) -> Array:
        """Return the distance (N,) in mm, at the edge's depth, between the planes in which neighbouring pixels see."""
        return np.asarray(1.0 / np.linalg.norm(self.by_point, axis=1))

    @property
    def direction(self) -> Array:
        """Return the unit direction (N, 3) in the part frame along which an offset along the normal is seen.

        It is perpendicular to the edge and to the line of sight: the one motion of the edge that the photo shows whole.
        """
        return self.by_point * self.mm_per_px[:, None]


def sightlines(part: Part, photos: Sequence[Photo], world_from_part: Rigid) -> Sightlines:
    """Return places every `STEP_PX` px on the edges and contours that the photos should show, the part being there."""
    sources = _sources(photos)
    each = [_in_photo(part, photo, i, world_from_part, sources) for i, photo in enumerate(photos)]
    joined = {f.name: np.concatenate([getattr(one, f.name) for one in each]) for f in fields(Sightlines)}
    _, edge = np.unique(np.stack([joined["photo"], joined["chain"]], axis=1), axis=0, return_inverse=True)
    joined["edge"] = edge.reshape(-1).astype(np.int64)
    return Sightlines(**(joined | {"along": _along(joined["q"], joined["normal"], joined["edge"])}))


def _in_photo(
    part: Part, photo: Photo, number: int, world_from_part: Rigid, sources: list[ErrorSource]
) -> Sightlines:
    camera_from_part = photo.viewpoint.camera_from_world @ world_from_part
    wires = part.lines.draw(photo.camera, camera_from_part)
    index, s = _spaced(wires.visible)
    p, q, normal = _places(wires, index, s)
    width, height = photo.camera.size
    inside = (q > _BORDER_PX).all(axis=1) & (q < np.array([width, height]) - 1 - _BORDER_PX).all(axis=1)
    p, q, normal, index = p[inside], q[inside], normal[inside], index[inside]
    _, dq_dp = photo.camera.project_with_jacobian(camera_from_part @ p)
    by_point = np.einsum("ni,nij,jk->nk", normal, dq_dp, camera_from_part.rotation)
    line = wires.visible.line_of_point[index]
    kept = np.isfinite(by_point).all(axis=1) & (np.abs(by_point).sum(axis=1) > 0)
    out = Sightlines(
        q,
        normal,
        p,
        by_point,
        _by_cause(photo, world_from_part @ p, normal, sources),
        np.zeros(len(p)),
        np.zeros(len(p), np.int64),
        wires.visible.part[line],
        wires.visible.kind[line],
        wires.visible.chain[line],
        np.full(len(p), number, np.int32),
    )
    return out.select(kept)


def _spaced(lines: Polylines) -> tuple[Longs, Array]:
    """Return the piece (its first point) and the share of it in the picture of places about `STEP_PX` apart."""
    of_point = lines.line_of_point
    first = np.flatnonzero(of_point[1:] == of_point[:-1])
    length = np.linalg.norm(lines.q[first + 1] - lines.q[first], axis=1)
    total = np.concatenate([[0.0], np.cumsum(length)])
    index, share = [], []
    for line in range(len(lines)):
        mine = np.flatnonzero(of_point[first] == line)
        if not len(mine) or total[mine[-1] + 1] - total[mine[0]] < 2 * _END_PX + STEP_PX:
            continue
        low, high = total[mine[0]] + _END_PX, total[mine[-1] + 1] - _END_PX
        n = int((high - low) // STEP_PX) + 1
        at = low + (high - low) * (np.arange(n) + 0.5) / n
        piece = np.clip(np.searchsorted(total, at, side="right") - 1, mine[0], mine[-1])
        index.append(first[piece])
        share.append((at - total[piece]) / np.maximum(length[piece], 1e-12))
    if not index:
        return np.zeros(0, np.int64), np.zeros(0)
    return np.concatenate(index), np.concatenate(share)


def _places(wires: Wireframe, index: Longs, s: Array) -> tuple[Array, Array, Array]:
    """Return p (mm, as the wires have it), q and normal of the places at share s of pieces in the picture."""
    lines, pose = wires.visible, wires.camera_from_world
    a, b = lines.p[index], lines.p[index + 1]
    za, zb = (pose @ a)[:, 2], (pose @ b)[:, 2]
    t = s * za / (zb + s * (za - zb))  # straight pieces: equal steps in the picture are not equal steps in space
    p = a + t[:, None] * (b - a)
    along = lines.q[index + 1] - lines.q[index]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return p, wires.camera.project(pose @ p), np.stack([-along[:, 1], along[:, 0]], axis=1)


def _along(q: Array, normal: Array, edge: Longs) -> Array:
    """Return the length of line (px) from the middle of its edge to each place."""
    if not len(q):
        return np.zeros(0)
    step = np.linalg.norm(np.diff(q, axis=0), axis=1)
    same = edge[1:] == edge[:-1]
    run = np.concatenate([[0.0], np.cumsum(np.where(same, step, 0.0))])
    count = np.bincount(edge)
    return np.asarray(run - (np.bincount(edge, run) / np.maximum(count, 1))[edge])


def _sources(photos: Sequence[Photo]) -> list[ErrorSource]:
    """Return the error sources of all photos, each once: photos with one owner err together."""
    seen: dict[int, ErrorSource] = {}
    for photo in photos:
        for source, _ in photo.viewpoint.errors:
            seen.setdefault(id(source.owner), source)
    return list(seen.values())


def _by_cause(photo: Photo, p_world: Array, normal: Array, sources: list[ErrorSource]) -> Array:
    if not sources:
        return np.zeros((len(p_world), 0))
    view = photo.viewpoint
    _, J = project_with_sensitivity(view.camera, view.camera_from_world, p_world)
    along_normal = np.einsum("ni,nij->nj", normal, J)
    mine = {id(source.owner): D for source, D in view.errors}
    none = np.zeros((along_normal.shape[1], 0))
    columns = []
    for source in sources:
        D = mine.get(id(source.owner), none)
        effect = along_normal @ D @ source.root if D.size else np.zeros((len(normal), len(source.covariance)))
        columns.append(effect)
    return np.concatenate(columns, axis=1)
