"""The triangles near a point: a bounding volume hierarchy over the triangles, queried for many points at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.mesh import Mesh

_LEAF = 2
_BLOCK = 40_000  # points searched together: bounds the memory of the search
_CROWD = 16  # points that are first tested as one box


class TriangleTree:
    """Boxes over runs of triangles that are neighbours in space and, as far as possible, of one body."""

    def __init__(self, mesh: Mesh, body: Longs) -> None:
        self.corners: Array = mesh.vertices[mesh.faces]
        low, high = self.corners.min(axis=1), self.corners.max(axis=1)
        self.body = body
        self.order: npt.NDArray[np.intp] = np.lexsort((_morton((low + high) / 2), body))
        depth = max(int(np.ceil(np.log2(max(len(low) / _LEAF, 1)))), 0)
        n = _LEAF << depth
        self.levels: list[tuple[Array, Array]] = _levels(
            _padded(low[self.order], n, np.inf), _padded(high[self.order], n, -np.inf)
        )
        self.owners: list[Longs] = _owners(_padded(body[self.order], n, -1), len(self.levels))

    def touching(self, points: Array, tolerance: float, *, apart_from: Longs) -> tuple[Longs, Longs]:
        """Return pairs (point, face): faces within `tolerance` of each point (N, 3), of another body than its own."""
        likely = np.flatnonzero(self._in_a_likely_place(points, tolerance, apart_from))
        found = [np.zeros((0, 2), np.int64)]
        for at in range(0, len(likely), _BLOCK):
            block = likely[at : at + _BLOCK]
            point, face = self._block(points[block], tolerance, apart_from[block])
            found.append(np.column_stack([block[point], face]))
        pairs = np.concatenate(found)
        return pairs[:, 0], pairs[:, 1]

    def _in_a_likely_place(self, points: Array, tolerance: float, own: Longs) -> Mask:
        """Return which points (N,) are in a small group whose box meets a leaf of another body: most are not."""
        likely = np.zeros(len(points), bool)
        if not len(points):
            return likely
        order = np.lexsort((_morton(points), own))
        start = np.union1d(np.arange(0, len(points), _CROWD), np.flatnonzero(np.diff(own[order])) + 1)
        low = np.minimum.reduceat(points[order], start) - tolerance
        high = np.maximum.reduceat(points[order], start) + tolerance
        near = np.zeros(len(start), bool)
        for at in range(0, len(start), _BLOCK):
            block = slice(at, at + _BLOCK)
            near[at + self._descended(low[block], high[block], own[order[start[block]]])[0]] = True
        likely[order] = np.repeat(near, np.diff(start, append=len(points)))
        return likely

    def _descended(self, low: Array, high: Array, own: Longs) -> tuple[Longs, Longs]:
        """Return pairs (query, leaf) where a box meets a leaf that holds a triangle of another body than its own."""
        low, high = np.ascontiguousarray(low.T), np.ascontiguousarray(high.T)  # gathered along one axis at a time
        query, node = np.arange(low.shape[1]), np.zeros(low.shape[1], np.int64)
        for depth, (node_low, node_high) in enumerate(self.levels):
            if depth:
                query, node = np.repeat(query, 2), (2 * node[:, None] + np.arange(2)).ravel()
            meets = self.owners[depth][node] != own[query]
            for axis in range(3):
                query, node = query[meets], node[meets]
                meets = (low[axis][query] <= node_high[axis][node]) & (high[axis][query] >= node_low[axis][node])
            query, node = query[meets], node[meets]
        return query, node

    def _block(self, points: Array, tolerance: float, own: Longs) -> tuple[Longs, Longs]:
        point, leaf = self._descended(points - tolerance, points + tolerance, own)
        point = np.repeat(point, _LEAF)
        slot = (_LEAF * leaf[:, None] + np.arange(_LEAF)).ravel()
        real = slot < len(self.order)
        point, face = point[real], self.order[slot[real]]
        other = self.body[face] != own[point]
        point, face = point[other], face[other]
        close = _near(points[point], self.corners[face], tolerance)
        return point[close], face[close]


def _padded(values: npt.NDArray[np.generic], n: int, fill: float) -> npt.NDArray[np.generic]:
    extra = np.full((n - len(values), *values.shape[1:]), fill, values.dtype)
    return np.concatenate([values, extra])


def _levels(low: npt.NDArray[np.generic], high: npt.NDArray[np.generic]) -> list[tuple[Array, Array]]:
    """Return the boxes (3, n) of each level, the root first; the last level holds leaves."""
    lowest: Array = np.asarray(low, float).reshape(-1, _LEAF, 3).min(axis=1)
    highest: Array = np.asarray(high, float).reshape(-1, _LEAF, 3).max(axis=1)
    levels = [(lowest, highest)]
    while len(lowest) > 1:
        lowest, highest = lowest.reshape(-1, 2, 3).min(axis=1), highest.reshape(-1, 2, 3).max(axis=1)
        levels.insert(0, (lowest, highest))
    return [(np.ascontiguousarray(least.T), np.ascontiguousarray(most.T)) for least, most in levels]


def _owners(body: npt.NDArray[np.generic], depth: int) -> list[Longs]:
    """Return for each box of each level the one body it holds, -2 where it holds several."""
    body = np.asarray(body, np.int64).reshape(-1, _LEAF)
    low, high = body.min(axis=1), body.max(axis=1)
    levels = [np.where(low == high, low, -2)]
    for _ in range(depth - 1):
        pairs = levels[0].reshape(-1, 2)
        levels.insert(0, np.where(pairs[:, 0] == pairs[:, 1], pairs[:, 0], -2))
    return levels


def _morton(points: Array) -> npt.NDArray[np.uint64]:
    """Return positions on a space-filling curve: 21 bits of each coordinate, interleaved."""
    low = points.min(axis=0, initial=np.inf)
    span = max(float((points.max(axis=0, initial=-np.inf) - low).max(initial=0)), 1e-300)
    cells = np.clip((points - low) / span * 2097151, 0, 2097151).astype(np.uint64)
    key = np.zeros(len(points), np.uint64)
    for axis in range(3):
        x = cells[:, axis]
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            x = (x | (x << np.uint64(shift))) & np.uint64(mask)
        key |= x << np.uint64(axis)
    return key


def _near(points: Array, corners: Array, tolerance: float) -> Mask:
    """Return which points (N, 3) lie within `tolerance` of their triangle (N, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    unit = normal / np.where(length > 0, length, 1)[:, None]
    height = np.abs(np.einsum("ij,ij->i", points - a, unit))
    inside = length > 0
    squared = np.full(len(points), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        side = q - p
        inside &= np.einsum("ij,ij->i", np.cross(side, points - p), normal) >= 0
        span = np.einsum("ij,ij->i", side, side)
        t = np.clip(np.einsum("ij,ij->i", points - p, side) / np.where(span > 0, span, 1), 0, 1)
        gap = points - (p + t[:, None] * side)
        squared = np.minimum(squared, np.einsum("ij,ij->i", gap, gap))
    return np.asarray((inside & (height <= tolerance)) | (squared <= tolerance**2))
