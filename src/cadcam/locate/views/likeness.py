"""What a part is nearly like: itself elsewhere, as one bay of a lattice is like the next, or its mirror image.

Where most of a part is symmetric, a pose with the rest on the wrong side fits nearly as well as the right one. So does
the mirror image: the part of the opposite hand, or a photo that was mirrored somewhere on its way. Only the edges that
the two readings do not share can tell which one a photo shows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.locate.views.turning import turns_onto
from cadcam.render.view import Scene

_EXACT, _CORNERS = 1e-3, 4  # tolerance for coinciding corners, in radii; corners needed for an exact shift
_CLOSE = 0.01  # tolerance for coinciding edges, in radii of the part
_COARSE = 0.03  # bin width of the shift histogram, in radii
_POINTS, _DENSE, _LAID = 400, 8_000, 120  # edge points: compared; of the target; used to vote for shifts
_FEW = 50  # points of a quick test whether a shift deserves a closer look
_SHIFTS = 8  # shifts tried per rotation, twice: on a lattice those by one bay rank behind many by none
_LEAST, _SAME = 0.45, 0.995  # coinciding share of the edges: below it no likeness; above it no visible difference
_MOST = {False: 12, True: 4}  # likenesses kept: of the part, of its mirror image; as many again by odd turns
_QUARTER = np.radians(3.0)  # turns this near to quarter turns are among these
_APART = 0.05  # radii: two motions are one if they differ by less at every point
_ALONG = np.cos(np.radians(3.0))  # edges this near to a direction run along it
_QUARTERS = [
    R
    for axes in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if np.linalg.det(R := np.eye(3)[list(axes)] * np.array(signs)[:, None]) > 0
]


def mirror_image(scene: Scene) -> Scene:
    """Return a scene mirrored in the plane across x through the middle of its box; edges and paint stay its own."""
    mesh = scene.mesh
    flip, normals = np.array([-1.0, 1.0, 1.0]), mesh.corner_normals
    vertices = mesh.vertices * flip + [2 * mesh.bounds[:, 0].mean(), 0.0, 0.0]
    if normals is not None:
        normals = np.asarray(normals[:, ::-1] * flip, np.float32)
    return replace(scene, mesh=replace(mesh, vertices=vertices, faces=mesh.faces[:, ::-1], corner_normals=normals))


@dataclass(frozen=True, slots=True, eq=False)
class Likeness:
    """A motion part_from_part, or part_from_mirrored, that lays this share of the edges on edges of the part."""

    motion: Rigid
    mirrored: bool
    share: float


def likenesses(mesh: Mesh, edges: FeatureEdges, image: Mesh) -> list[Likeness]:
    """Return the motions that lay a part of a mesh, or its mirror image, nearly on itself, best first.

    Exact symmetries are left out, as no photo can distinguish them; a part that is its own mirror image has no mirrored
    likeness. Quarter turns about the directions in which most edges run are tried, each with the shift that brings the
    middles together and with those that bring most points into coincidence; and about these directions, through the
    middle, whatever other turns bring many edges onto edges, as of a ring of holes (`locate.views.turning`).
    """
    points = even_points(mesh, edges, _POINTS)
    if not len(points):
        return []
    target = _Target(mesh, edges, points)
    found: list[Likeness] = []
    for other, mirrored in ((mesh, False), (image, True)):
        laid = target.laid(other, edges, mirrored)
        if not (mirrored and any(one.share > _SAME for own in laid for one in own)):
            found += [one for own in laid for one in [one for one in own if one.share <= _SAME][: _MOST[mirrored]]]
    return sorted(found, key=lambda one: -one.share)


class _Target:
    """The edges onto which others are laid."""

    def __init__(self, mesh: Mesh, edges: FeatureEdges, points: Array) -> None:
        from scipy.spatial import cKDTree

        self.points, self.corners, self.frame = points, _corners(mesh, edges), _directions(mesh, edges)
        self.centre, self.middle = points.mean(axis=0), _middle(points, self.frame)
        self.radius = float(np.linalg.norm(points - self.centre, axis=1).max())
        self.tree = cKDTree(even_points(mesh, edges, _DENSE))
        self.corner_tree = cKDTree(self.corners)

    def laid(self, mesh: Mesh, edges: FeatureEdges, mirrored: bool) -> tuple[list[Likeness], list[Likeness]]:
        """Return how the edges of another mesh may be laid on these by quarter turns, and by others, best first."""
        own, points, corners = _directions(mesh, edges), even_points(mesh, edges, _POINTS), _corners(mesh, edges)
        every = []
        for quarter in _QUARTERS:
            turn = self.frame @ quarter @ own.T
            turned = points @ turn.T
            shifts = [self.middle - _middle(turned, self.frame)]  # a part turned over often lies in its own place
            shifts += _shifts(turned, self.points, self._coarse) + _shifts(corners @ turn.T, self.corners, self._coarse)
            laid = [self._settled(turned, turn, by, mirrored) for by in shifts if self._may_lie(turned + by)]
            every += laid if mirrored else [both for one in laid for both in (one, replace(one, motion=one.motion.inv))]
        turned_on = [self._settled(points @ turn.T, turn, by, mirrored) for turn, by in self._turns(mesh, edges, own)]
        by_quarters = self._distinct(every, [])
        by_others = self._distinct(turned_on, by_quarters)
        return [self._sharpened(one, corners) for one in by_quarters], by_others

    def _distinct(self, likes: Iterable[Likeness], others: Sequence[Likeness]) -> list[Likeness]:
        """Return those that lay enough edges and are neither each other nor one of the others, best first."""
        kept: list[Likeness] = []
        for one in sorted((e for e in likes if e.share >= _LEAST), key=lambda e: -e.share):
            if all(self._apart(one.motion, k.motion) > _APART * self.radius for k in (*others, *kept)):
                kept.append(one)
        return kept

    def _turns(self, mesh: Mesh, edges: FeatureEdges, own: Array) -> Iterator[tuple[Array, Array]]:
        """Yield turns about this frame's axes other than by quarters, the part upright or turned over, and shifts.

        own (3, 3): the frame of the other mesh.
        """
        points = even_points(mesh, edges, _POINTS)
        centre = _middle(points, own)
        p, q = (points - centre) @ own, (self.tree.data - self.middle) @ self.frame
        for axis, over in product(range(3), (False, True)):
            upright = np.roll(np.eye(3), -axis - 1, axis=0)  # rows: the axis is the last
            before = np.diag([1.0, -1.0, -1.0]) @ upright if over else upright
            for angle, up in turns_onto(p @ before.T, q @ upright.T, self.radius, _LEAST):
                if over or abs((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4) > _QUARTER:
                    turn = self.frame @ upright.T @ exp(np.array([0, 0, angle])) @ before @ own.T
                    yield turn, self.middle - turn @ centre + up * self.frame @ upright[2]

    def _sharpened(self, like: Likeness, corners: Array) -> Likeness:
        """Return a likeness whose shift is refined to lay most corners (n, 3) on corners, if some coincide.

        Edges determine a shift only to about the plates' thickness. In a picture of a few bays that is a large error.
        """
        from scipy.spatial import cKDTree

        if not len(corners) or not len(self.corners):
            return like
        some = corners[:: max(1, len(corners) // _POINTS)]  # compared with all corners: large models have thousands
        moved, near = like.motion @ some, 2 * _CLOSE * self.radius
        pairs = self.corner_tree.query_ball_point(moved, near)
        by = np.concatenate([self.corners[k] - p for k, p in zip(pairs, moved, strict=True)])
        if len(by) < _CORNERS:
            return like
        tree, exact = cKDTree(by), _EXACT * self.radius
        votes = np.asarray(tree.query_ball_point(by, exact, return_length=True))
        most = tree.query_ball_point(by[int(np.argmax(votes))], exact)
        if len(most) < _CORNERS:
            return like
        shifted = Rigid(like.motion.rotation, like.motion.translation + by[most].mean(axis=0))
        return replace(like, motion=shifted)

    @property
    def _coarse(self) -> float:
        return _COARSE * self.radius

    def _may_lie(self, points: Array) -> bool:
        """Return whether enough of these points (n, 3) lie near edges for the shift to be worth refining."""
        few = points[:: len(points) // _FEW]
        near = self.tree.query(few, distance_upper_bound=2 * self._coarse)[0]
        return bool(np.mean(np.isfinite(near)) >= _LEAST)

    def _settled(self, turned: Array, turn: Array, shift: Array, mirrored: bool) -> Likeness:
        """Return the likeness whose shift lays most of the turned points (n, 3) on these edges."""
        for within in (_COARSE, _CLOSE, _CLOSE):
            apart, nearest = self.tree.query(turned + shift, distance_upper_bound=2 * within * self.radius)
            close = np.isfinite(apart)
            if close.any():
                shift = shift + np.median(self.tree.data[np.asarray(nearest)[close]] - turned[close] - shift, axis=0)
        near = self.tree.query(turned + shift, distance_upper_bound=_CLOSE * self.radius)[0]
        return Likeness(Rigid(turn, shift), mirrored, float(np.mean(np.isfinite(near))))

    def _apart(self, one: Rigid, other: Rigid) -> float:
        """Return the largest distance between a point's images under two motions."""
        few = self.points[:: len(self.points) // 20]
        return float(np.linalg.norm(one @ few - other @ few, axis=1).max())


def _middle(points: Array, frame: Array) -> Array:
    """Return the middle (3,) of the box of points (n, 3) along the axes of a frame (3, 3)."""
    along = points @ frame
    return np.asarray(frame @ (along.min(axis=0) + along.max(axis=0)) / 2)


def _shifts(p: Array, q: Array, step: float) -> list[Array]:
    """Return shifts (3,) that bring most points p (n, 3) near points q (m, 3), best first, accurate to about `step`."""
    if not len(p):
        return []
    few, others = (a[:: max(1, len(a) // _LAID)] for a in (p, q))
    by = ((others[:, None] - few[None]) / step).reshape(-1, 3).T.copy()
    cell = np.round(by).astype(np.int32)
    cell -= cell.min(axis=1, keepdims=True)
    x, y, z = cell
    _, many_y, many_z = cell.max(axis=1) + 1
    keys, its, count = np.unique((x * many_y + y) * many_z + z, return_inverse=True, return_counts=True)
    cells = np.stack([keys // many_z // many_y, keys // many_z % many_y, keys % many_z]).astype(np.int16)
    votes, sums, out = count.copy(), np.stack([np.bincount(its, weights=along) for along in by]), []
    for _ in range(min(_SHIFTS, len(keys))):
        apart = np.abs(cells - cells[:, int(np.argmax(votes)), None]).max(axis=0)
        out.append(np.asarray(step * sums[:, apart <= 1].sum(axis=1) / count[apart <= 1].sum()))
        votes[apart <= 2] = 0
    return out


def even_points(mesh: Mesh, edges: FeatureEdges, n: int) -> Array:
    """Return n points (n, 3) evenly along the edges; none where there are no edges."""
    a, b = (mesh.vertices[edges.vertices[:, k]] for k in range(2))
    ends = np.cumsum(np.linalg.norm(b - a, axis=1))
    if not len(ends) or not ends[-1] > 0:
        return np.zeros((0, 3))
    at = (np.arange(n) + 0.5) / n * ends[-1]
    on = np.searchsorted(ends, at)
    t = (ends[on] - at) / np.diff(ends, prepend=0.0)[on]
    return np.asarray(b[on] + t[:, None] * (a[on] - b[on]))


def _corners(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return the corners (n, 3) where long edges end: unlike points on a line, they fix the shift along it."""
    long = edges.lengths(mesh) > _COARSE * float(np.linalg.norm(mesh.size_mm))
    return np.asarray(mesh.vertices[np.unique(edges.vertices[long])])


def _directions(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return an orthonormal frame (3, 3), as columns: the main direction of the edges, the next, and their normal."""
    a, b = (mesh.vertices[edges.vertices[:, k]] for k in range(2))
    length = np.linalg.norm(b - a, axis=1)
    way = (b - a) / np.maximum(length, 1e-300)[:, None]
    first = _mostly(way, length)
    across = np.abs(way @ first) < np.sqrt(1 - _ALONG**2)
    second = _mostly(way[across], length[across]) if across.any() else np.linalg.svd(first[None])[2][1]
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=1)


def _mostly(way: Array, length: Array) -> Array:
    """Return that of the directions (n, 3) along which the greatest length runs."""
    tried = way[np.argsort(-length, kind="stable")[:_LAID]]
    return np.asarray(tried[int(np.argmax((np.abs(tried @ way.T) > _ALONG) @ length))])
