"""Triangulation of polygons."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Longs, Mask


@np.errstate(over="ignore", invalid="ignore")  # implausible coordinates are refused later, with their place
def triangulated(vertices: Array, counts: Longs, corners: Longs) -> tuple[Longs, Longs]:
    """Return triangles (T, 3) and the polygon (T,) each comes from.

    `corners` lists the vertex indices of all polygons one after the other, `counts` how many each has (polygons with
    fewer than three give nothing). Quadrangles are cut along the shorter interior diagonal, larger polygons by ear
    clipping, so that concave outlines are correct. The order of the polygons and their orientation are kept.
    """
    start = np.cumsum(counts) - counts
    triangles, owners = [], []
    three, four = np.flatnonzero(counts == 3), np.flatnonzero(counts == 4)
    triangles.append(corners[start[three, None] + np.arange(3)])
    owners.append(three)
    if len(four):
        quads = corners[start[four, None] + np.arange(4)]
        triangles.append(_cut_quads(vertices, quads).reshape(-1, 3))
        owners.append(np.repeat(four, 2))
    for polygon in np.flatnonzero(counts > 4):
        loop = corners[start[polygon] : start[polygon] + counts[polygon]]
        cut = loop[clip_ears(_flattened(vertices[loop]))]
        triangles.append(cut)
        owners.append(np.full(len(cut), polygon))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def fan(corners: Longs) -> Longs:
    """Return the triangles (T, 3) of a fan: the first of n corners with every two that follow each other."""
    k = np.arange(max(len(corners) - 2, 0))
    return np.column_stack([np.full(len(k), corners[0] if len(k) else 0), corners[k + 1], corners[k + 2]])


def strip(corners: Longs) -> Longs:
    """Return the triangles (T, 3) of a strip: every three of n corners that follow each other, all wound alike."""
    k = np.arange(max(len(corners) - 2, 0))
    odd = k % 2
    return np.column_stack([corners[k], corners[k + 1 + odd], corners[k + 2 - odd]])


def _cut_quads(vertices: Array, quads: Longs) -> Longs:
    """Return two triangles (Q, 2, 3) for each quadrangle."""
    p = vertices[quads]
    normal = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])
    worst = []
    for k in (0, 1):  # the diagonal from corner k to corner k + 2
        a, b, c, d = (p[:, (k + i) % 4] for i in range(4))
        first = np.einsum("ij,ij->i", np.cross(b - a, c - a), normal)
        second = np.einsum("ij,ij->i", np.cross(c - a, d - a), normal)
        worst.append(np.minimum(first, second))
    length = [np.linalg.norm(p[:, k + 2] - p[:, k], axis=1) for k in (0, 1)]
    both = (worst[0] > 0) & (worst[1] > 0)
    from_zero = np.where(both, length[0] <= length[1] * (1 + 1e-9), worst[0] >= worst[1])
    turned = np.where(from_zero[:, None], quads, np.roll(quads, -1, axis=1))
    return np.asarray(turned[:, [[0, 1, 2], [0, 2, 3]]])


def _flattened(loop: Array) -> Array:
    """Return the polygon (N, 3) in the plane of its Newell normal, (N, 2), counter-clockwise."""
    ahead = np.roll(loop, -1, axis=0)
    normal = np.cross(loop - loop[0], ahead - loop[0]).sum(axis=0)
    length = np.linalg.norm(normal)
    if not length > 0:
        return np.zeros((len(loop), 2))
    axis = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(axis, normal / length)
    x /= np.linalg.norm(x)
    return np.column_stack([(loop - loop[0]) @ x, (loop - loop[0]) @ np.cross(normal / length, x)])


def clip_ears(loop: Array) -> Longs:
    """Return triangles (N - 2, 3) as indices into the simple counter-clockwise polygon (N, 2).

    Among the ears, the one with the largest smallest angle is cut first, which avoids most needles. A polygon that
    crosses itself has no proper ears at some point; it is then cut into a fan, as good as any other choice.
    """
    before, after = np.roll(np.arange(len(loop)), 1), np.roll(np.arange(len(loop)), -1)
    left, within = np.ones(len(loop), bool), np.full(len(loop), -1)
    quality = _ear_quality(loop[before], loop, loop[after])
    triangles = []
    for _ in range(len(loop) - 3):
        ear = _best_ear(loop, before, after, quality, left, within)
        a, b = int(before[ear]), int(after[ear])
        triangles.append([a, ear, b])
        left[ear], quality[ear] = False, -np.inf
        after[a], before[b] = b, a
        within[[a, b]] = -1
        quality[[a, b]] = _ear_quality(loop[before[[a, b]]], loop[[a, b]], loop[after[[a, b]]])
    triangles.append(np.flatnonzero(left).tolist())
    return np.array(triangles, np.int64)


def _ear_quality(a: Array, b: Array, c: Array) -> Array:
    """Return twice the signed area over the longest side squared: 0.87 for equal sides, negative where concave."""
    area = turn(a, b, c)
    longest = np.max([((p - q) ** 2).sum(axis=-1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return np.asarray(area / np.maximum(longest, 1e-300))


def _best_ear(loop: Array, before: Longs, after: Longs, quality: Array, left: Mask, within: Longs) -> int:
    """Return the best corner that is an ear, else the best; the first of several as good.

    within (N,): for each corner another that was found in its triangle, or -1: as long as that is left, and the
    triangle is the same, it is no ear. It is kept up to date.
    """
    best = ear = int(np.argmax(quality))
    untried = quality
    while untried[ear] > 0:
        if within[ear] < 0 or not left[within[ear]]:
            within[ear] = _corner_within(loop, loop[[before[ear], ear, after[ear]]], left)
            if within[ear] < 0:
                return ear
        untried = untried.copy() if untried is quality else untried
        untried[ear] = -np.inf
        ear = int(np.argmax(untried))
    return best


def _corner_within(loop: Array, triangle: Array, left: Mask) -> int:
    """Return one of the corners (N, 2) left that lies in or on a triangle (3, 2), but at no corner of it; else -1."""
    (left_x, low_y), (right_x, high_y) = triangle.min(axis=0), triangle.max(axis=0)
    x, y = loop.T
    near = np.flatnonzero(left & (x >= left_x) & (x <= right_x) & (y >= low_y) & (y <= high_y))  # few of many
    at = loop[near]
    a, b, c = triangle
    inside = (turn(a, b, at) >= 0) & (turn(b, c, at) >= 0) & (turn(c, a, at) >= 0)
    corner = (at == a).all(axis=1) | (at == b).all(axis=1) | (at == c).all(axis=1)
    found = near[inside & ~corner]
    return int(found[0]) if len(found) else -1


def turn(a: Array, b: Array, c: Array) -> Array:
    """Return twice the signed areas (...) of triangles of points (..., 2): positive where a, b, c turn left."""
    ab, ac = b - a, c - a
    return np.asarray(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])
