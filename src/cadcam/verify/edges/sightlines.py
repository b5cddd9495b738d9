"""Places on the part's visible edges, and what moves their images: the part, its features, the camera's errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Mask
from cadcam.cad.edge_kind import EdgeKind
from cadcam.camera.error_source import ErrorSource, by_unit_errors, distinct_sources
from cadcam.camera.sensitivity import project_with_sensitivity
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import noise_of
from cadcam.locate.lines.edges import EdgeSamples, project, sample_lines
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.lines.wireframe import LineOptions

STEP_PX, REACH_PX = 4.0, 7.0  # length of the cell that a place stands for; how far it reaches to each side
_LINES = LineOptions(margin_px=0.0)
_NEARLY_ALL = 0.6  # share of an edge's length from one end of a piece to the other that only its two ends are apart
_BENT, _LEAST = np.pi / 2, 3  # turn beyond which pieces of an edge face different ways; fewest places of a piece


@dataclass(frozen=True, slots=True, eq=False)
class Sightlines:
    """N places on visible edges, in the photos and on the part.

    q (N, 2) px: where the model has them; normal (N, 2) across the edge; p (N, 3) mm in the part frame; by_point (N, 3)
    px/mm: derivative of the image, along its normal, by the place on the part; by_cause (N, r) px: by each of r
    independent unit errors of cameras and their poses; along (N,) px: position along its edge, 0 in the edge's middle;
    room (N,) px: distance to the next other line across it; edge (N,): number of its edge in its photo, from 0; rim
    (N,): likewise, one for all arcs of a circle; bore (N,): one for all rims of a hole or pin; part, kind, chain, photo
    (N,): to which it belongs.
    """

    q: Array
    normal: Array
    p: Array
    by_point: Array
    by_cause: Array
    along: Array
    room: Array
    edge: Longs
    rim: Longs
    bore: Longs
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
        """Return the derivative of the image along its normal by xi of world_from_part @ Rigid.exp(xi), (N, 6) px."""
        return np.concatenate([self.by_point, np.cross(self.p, self.by_point)], axis=1)

    @property
    def mm_per_px(self) -> Array:
        """Return the length (N,) in mm at the edge's depth that one px covers."""
        return np.asarray(1.0 / np.linalg.norm(self.by_point, axis=1))

    @property
    def outward(self) -> Array:
        """Return the sign (N,) of each edge's normals: 1 if they point out of its rim, -1 if they point into it.

        Edges run either way round, so do the arcs of one circle.
        """
        count = np.maximum(np.bincount(self.rim), 1)
        middle = np.stack([np.bincount(self.rim, x) / count for x in self.q.T], axis=1)
        out = np.einsum("ni,ni->n", self.normal, self.q - middle[self.rim])
        return np.where(np.bincount(self.edge, out)[self.edge] < 0, -1.0, 1.0)

    @property
    def widening(self) -> Array:
        """Return how far (N,) px each place moves across its edge for each mm by which its flat rim is larger.

        In the rim's plane a place that moves along its edge does not move across it: what is left is out of the rim.
        """
        count = np.maximum(np.bincount(self.rim), 1)
        middle = np.stack([np.bincount(self.rim, x) / count for x in self.p.T], axis=1)
        arm = self.p - middle[self.rim]
        spread = np.stack([np.bincount(self.rim, x * y) for x in arm.T for y in arm.T], axis=1).reshape(-1, 3, 3)
        upright = np.linalg.eigh(spread)[1][:, :, 0]
        return np.asarray(np.linalg.norm(np.cross(self.by_point, upright[self.rim]), axis=1))

    @property
    def direction(self) -> Array:
        """Return the unit direction (N, 3) in the part frame along which an offset along the normal is observed.

        It is perpendicular to the edge and to the line of sight: the motion of the edge that the photo shows in full.
        """
        return self.by_point * self.mm_per_px[:, None]


def pieces(edge: Longs, normal: Array) -> Longs:
    """Return the number (N,) of the piece of its edge that each place is on; pieces of a bent edge face different ways.

    An edge that turns by less than about a right angle is one piece, the rim of a hole four.
    """
    if not len(edge):
        return np.zeros(0, np.int64)
    ways = round(2 * np.pi / _BENT)
    order = np.argsort(edge, kind="stable")
    begins = np.flatnonzero(np.diff(edge[order], prepend=edge[order[0]] - 1))
    of = np.repeat(np.arange(len(begins)), np.diff(begins, append=len(edge)))
    way = np.exp(1j * np.arctan2(normal[order, 1], normal[order, 0]))
    middle = np.angle(np.add.reduceat(way, begins))[of]
    number = np.floor(np.angle(way * np.exp(-1j * middle)) / _BENT + 0.5).astype(np.int64) % ways
    count = np.bincount(ways * of + number, minlength=ways * len(begins)).reshape(-1, ways)
    long = count >= _LEAST
    none = np.flatnonzero(~long.any(axis=1))
    long[none, np.argmax(count[none] > 0, axis=1)] = True
    turn = np.abs(np.angle(np.exp(1j * _BENT * (np.arange(ways)[:, None] - np.arange(ways)))))
    apart = np.where(long[of], turn[number], np.inf)
    rank = np.cumsum(long).reshape(long.shape) - 1  # of a piece among those of all edges
    out = np.zeros(len(edge), np.int64)
    out[order] = rank[of, np.argmin(apart, axis=1)]
    return out


def erring_alike(lines: Sightlines, datum: Mask) -> tuple[Longs, Array]:
    """Return the number (N,) of what errs alike at each place, and the arc length (N,) px of the places along it.

    An edge, mostly. But a shadow inside a hole moves a quarter of its rim: of the datum (N,), whose pose that would
    turn by many of its sigmas, the pieces of bent edges err each by itself. What is judged errs as one.
    """
    piece = pieces(lines.edge, lines.normal)
    begin, end = _ends(lines.edge, lines.along)
    first, last = _ends(piece, lines.along)
    some = np.bincount(piece)[piece] < np.bincount(lines.edge)[lines.edge]
    through = some & (last - first > _NEARLY_ALL * (end - begin))  # of a rim, the piece in which it begins and ends
    after = datum & through & (lines.along < (begin + end) / 2)
    number = np.where(datum, 1 + int(lines.edge.max(initial=0)) + piece, lines.edge)
    return number, lines.along + np.where(after, end - begin + STEP_PX, 0.0)


def _ends(number: Longs, along: Array) -> tuple[Array, Array]:
    """Return the least and the largest (N,) of the arc lengths (N,) of each place's number (N,)."""
    order = np.lexsort((along, number))
    begins = np.flatnonzero(np.diff(number[order], prepend=-1))
    each = np.stack([begins, np.append(begins, len(order))[1:] - 1]) if len(order) else np.zeros((2, 0), np.int64)
    at = np.unique(number, return_inverse=True)[1].reshape(-1)
    first, last = along[order][each][:, at]
    return first, last


def curvature(lines: Sightlines) -> Array:
    """Return the curvature (N,), 1/px, of the edges at their places; that of contours is taken as 0."""
    order = np.lexsort([lines.along, lines.edge])
    edge, along, normal = lines.edge[order], lines.along[order], lines.normal[order]
    apart = np.diff(along)
    run = (edge[1:] == edge[:-1]) & (apart < 2 * STEP_PX) & (lines.kind[order][1:] != EdgeKind.CONTOUR)
    turn = np.arccos(np.clip(np.einsum("ni,ni->n", normal[1:], normal[:-1]), -1.0, 1.0))
    turned, length = (np.concatenate([[0.0], np.where(run, v, 0.0), [0.0]]) for v in (turn, apart))
    out = np.zeros(len(order))
    out[order] = (turned[1:] + turned[:-1]) / np.maximum(length[1:] + length[:-1], 1e-300)
    return out


def sightlines(part: Part, photos: Sequence[Photo], world_from_part: Rigid) -> tuple[Sightlines, list[Sight]]:
    """Return places every `STEP_PX` px on the edges and contours that the photos should show, and each photo's sight.

    The places of a photo are consecutive, in the order of its sight's samples.
    """
    lines, samples = lines_in_view(part, [photo.viewpoint for photo in photos], world_from_part)
    pairs = zip(photos, samples, strict=True)
    return lines, [Sight(photo, noise_of(photo.gray), world_from_part, of_photo) for photo, of_photo in pairs]


def lines_in_view(
    part: Part, views: Sequence[Viewpoint], world_from_part: Rigid
) -> tuple[Sightlines, list[EdgeSamples]]:
    """Return the places of `sightlines`, and their samples in each view: no photo is needed to know them."""
    sources = distinct_sources([source for view in views for source, _ in view.errors])
    each = [_in_view(part, view, i, world_from_part, sources) for i, view in enumerate(views)]
    joined = {f.name: np.concatenate([getattr(lines, f.name) for lines, _ in each]) for f in fields(Sightlines)}
    joined["edge"] = _numbered(joined["photo"], joined["chain"])
    joined["rim"] = _numbered(joined["photo"], joined["rim"])
    joined["bore"] = _numbered(joined["photo"], joined["bore"])
    joined["along"] = _along(joined["q"], joined["edge"])
    return Sightlines(**joined), [samples for _, samples in each]


def _numbered(photo: Ids, line: Ids | Longs) -> Longs:
    """Return the number (N,), from 0, of each line in each photo."""
    _, number = np.unique(np.stack([photo, line], axis=1), axis=0, return_inverse=True)
    return np.asarray(number.reshape(-1), np.int64)


def _in_view(
    part: Part, view: Viewpoint, number: int, world_from_part: Rigid, sources: list[ErrorSource]
) -> tuple[Sightlines, EdgeSamples]:
    camera, camera_from_part = view.camera, view.camera_from_world @ world_from_part
    wires = part.lines.draw(camera, camera_from_part, options=_LINES).visible
    samples = sample_lines(wires, camera, step_px=STEP_PX, reach_px=2 * REACH_PX)
    at = project(samples, camera, camera_from_part)
    samples = samples.select(np.asarray(at.imaged & np.isfinite(at.row).all(axis=1) & at.row.any(axis=1)))
    at = project(samples, camera, camera_from_part)
    n, chain = len(samples), wires.chain[samples.line]
    contours = np.arange(len(part.rims), max(int(chain.max(initial=-1)) + 1, len(part.rims)))
    lines = Sightlines(
        at.q,
        at.normal,
        samples.p,
        at.row[:, :3],
        _by_cause(view, world_from_part @ samples.p, at.normal, sources),
        np.zeros(n),
        np.minimum(samples.below, samples.above),
        np.zeros(n, np.int64),
        np.concatenate([part.rims, contours])[chain],
        np.concatenate([part.bores, contours])[chain],
        samples.part,
        wires.kind[samples.line],
        chain,
        np.full(n, number, np.int32),
    )
    return lines, samples


def _along(q: Array, edge: Longs) -> Array:
    """Return the arc length (px) from the middle of its edge to each place."""
    if not len(q):
        return np.zeros(0)
    step = np.linalg.norm(np.diff(q, axis=0), axis=1)
    same = edge[1:] == edge[:-1]
    run = np.concatenate([[0.0], np.cumsum(np.where(same, step, 0.0))])
    count = np.bincount(edge)
    return np.asarray(run - (np.bincount(edge, run) / np.maximum(count, 1))[edge])


def _by_cause(view: Viewpoint, p_world: Array, normal: Array, sources: list[ErrorSource]) -> Array:
    if not sources:
        return np.zeros((len(p_world), 0))
    _, J = project_with_sensitivity(view.camera, view.camera_from_world, p_world)
    along_normal = np.einsum("ni,nij->nj", normal, J)
    return by_unit_errors([(source, along_normal @ D) for source, D in view.errors], sources, (len(normal),))[0]
