"""Building blocks of sample parts: outlines, plates with holes, strips, tubes; all closed, surfaces numbered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.cad.formats.polygons import clip_ears, turn
from cadcam.cad.mend import mend
from cadcam.cad.mesh import Mesh
from cadcam.cad.topology import components

Rows = Sequence[Sequence[float]] | Array
Color = tuple[float, float, float]
Piece = tuple[Array, Longs, int]  # points, triangles, surface

# Sides of a plate's rim that turn by less than this are one smooth wall: arcs have at least twelve sides to the circle.
SMOOTH_DEG = 40.0


def arc(centre: Sequence[float], radius: float, start_deg: float, end_deg: float, n: int) -> Array:
    """Return n + 1 points (n + 1, 2) on an arc, both ends included."""
    t = np.radians(np.linspace(start_deg, end_deg, n + 1))
    return np.asarray(centre, float) + radius * np.column_stack([np.cos(t), np.sin(t)])


def circle(centre: Sequence[float], radius: float, n: int) -> Array:
    """Return n points (n, 2), counter-clockwise from the x axis."""
    return arc(centre, radius, 0, 360, n)[:-1]


def rounded(low: Sequence[float], high: Sequence[float], radius: float, q: int) -> Array:
    """Return a rectangle (4 q + 4, 2) whose corners are quarter circles of q sides, counter-clockwise."""
    (x0, y0), (x1, y1) = low, high
    corners = [
        (x1 - radius, y0 + radius),
        (x1 - radius, y1 - radius),
        (x0 + radius, y1 - radius),
        (x0 + radius, y0 + radius),
    ]
    return np.concatenate([arc(c, radius, -90 + 90 * k, 90 * k, q) for k, c in enumerate(corners)])


def filled(outline: Rows, holes: Sequence[Array] = ()) -> tuple[Array, Longs]:
    """Return points (N, 2) and triangles (T, 3) of a counter-clockwise outline with holes; no points are added."""
    loops = [np.asarray(outline, float), *(np.asarray(hole, float) for hole in holes)]
    points = np.concatenate(loops)
    starts = np.cumsum([0] + [len(loop) for loop in loops])
    path = np.arange(len(loops[0]))
    for k in sorted(range(1, len(loops)), key=lambda k: -loops[k][:, 0].max()):
        hole = np.arange(starts[k], starts[k + 1])[::-1]  # holes run clockwise
        path = _bridged(points, path, hole)
    return points, path[clip_ears(points[path])]


def _bridged(points: Array, path: Longs, hole: Longs) -> Longs:
    """Return the path joined with the hole by a cut from the hole's rightmost corner to a corner it can see."""
    h = int(np.argmax(points[hole, 0]))
    start = points[hole[h]]
    order = np.argsort(np.linalg.norm(points[path] - start, axis=1), kind="stable")
    starts, at, ends = (points[np.roll(path, k)] for k in (1, 0, -1))
    inward = _inward(start, starts, at, ends)
    for i in order:
        if at[i, 0] >= start[0] and inward[i] and _sees(start, at[i], at, ends):
            return np.concatenate([path[: i + 1], hole[h:], hole[: h + 1], path[i:]])
    raise AssertionError("a hole outside its outline")  # an error in this package, not of a caller


def _inward(p: Array, before: Array, at: Array, after: Array) -> Mask:
    """Return which corners (n,) of a path see p between their sides: of those met twice, at the ends of cuts, one."""
    left_of_both = (turn(before, at, p) >= 0, turn(at, after, p) >= 0)
    return np.where(turn(before, at, after) >= 0, np.logical_and(*left_of_both), np.logical_or(*left_of_both))


def _sees(a: Array, b: Array, p: Array, q: Array) -> bool:
    """Return whether no side p-q crosses the open segment a-b."""
    apart = (turn(a, b, p) * turn(a, b, q) < 0) & (turn(p, q, a) * turn(p, q, b) < 0)
    return not bool(apart.any())


def extruded(cells: Sequence[tuple[Array, Longs]], low: float, high: float, *, name: str, color: Color | None) -> Mesh:
    """Return the closed plate over a flat triangulation in x, y, from z = low to z = high.

    The cells meet along whole sides. Surfaces: 0 the top, 1 the bottom, then one for each smooth run of the rim.
    """
    at = np.cumsum([0] + [len(points) for points, _ in cells])
    flat = np.concatenate([points for points, _ in cells])
    triangles = np.concatenate([faces + at[k] for k, (_, faces) in enumerate(cells)])
    _, first, inverse = np.unique(np.round(flat, 6) + 0.0, axis=0, return_index=True, return_inverse=True)
    flat, triangles = flat[first], inverse.ravel()[triangles]
    n = len(flat)
    rim = _rim(triangles, n)
    a, b = rim.T
    walls = np.concatenate([np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])])
    run = _runs(flat, rim) + 2
    return Mesh.single(
        np.concatenate([np.column_stack([flat, np.full(n, low)]), np.column_stack([flat, np.full(n, high)])]),
        np.concatenate([triangles + n, triangles[:, ::-1], walls]),
        name=name,
        surface=np.concatenate([np.zeros(len(triangles)), np.ones(len(triangles)), run, run]).astype(np.int32),
        color=color,
    )


def _rim(triangles: Longs, n: int) -> Longs:
    """Return the sides (R, 2) that belong to one triangle only, directed as it runs."""
    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    return np.column_stack([a, b])[~np.isin(a * n + b, b * n + a)]


def _runs(points: Array, rim: Longs) -> Longs:
    """Return the number (R,) of the smooth run that each side of the rim belongs to."""
    leaving = np.full(len(points), -1)
    leaving[rim[:, 0]] = np.arange(len(rim))
    following = leaving[rim[:, 1]]
    along = points[rim[:, 1]] - points[rim[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    smooth = np.einsum("ij,ij->i", along, along[following]) > np.cos(np.radians(SMOOTH_DEG))
    return components(np.column_stack([np.flatnonzero(smooth), following[smooth]]), len(rim))


def box(low: Sequence[float], high: Sequence[float], *, name: str, color: Color | None = None) -> Mesh:
    """Return a box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    outline = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)
    return extruded([(outline, np.array([(0, 1, 2), (0, 2, 3)]))], z0, z1, name=name, color=color)


def prism(outline: Rows, low: float, high: float, *, name: str, color: Color | None = None) -> Mesh:
    """Return the closed prism over a counter-clockwise outline in x, y."""
    return extruded([filled(outline)], low, high, name=name, color=color)


def turned(mesh: Mesh, axes: str) -> Mesh:
    """Return the mesh with its local axes laid along "yz", "xz" ... of the world.

    The first letter is where local x goes, the second where local y goes; local z goes along their cross product, so
    nothing is mirrored.
    """
    unit = {"x": np.eye(3)[0], "y": np.eye(3)[1], "z": np.eye(3)[2]}
    u, v = unit[axes[0]], unit[axes[1]]
    world_from_local = np.column_stack([u, v, np.cross(u, v)])
    return replace(mesh, vertices=mesh.vertices @ world_from_local.T)


def moved(mesh: Mesh, shift: Sequence[float] | Array) -> Mesh:
    """Return the mesh moved by (x, y, z) mm."""
    return replace(mesh, vertices=mesh.vertices + np.asarray(shift, float))


def named(mesh: Mesh, name: str) -> Mesh:
    """Return the mesh of one part under another name."""
    return replace(mesh, part_names=(name,))


def tube(spine: Array, across: Array, radii: tuple[float, float], n: int, *, name: str, color: Color) -> Mesh:
    """Return a pipe of n sides with an outer and an inner radius along a spine (M, 3) that lies in a plane.

    `across` is the normal of that plane. Rings stand square to the spine, mitred where it bends.
    """
    step = np.diff(spine, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, across)
    stretch = np.concatenate([[1.0], 1 / np.einsum("ij,ij->i", tangent[1:-1], step[:-1]), [1.0]])
    t = 2 * np.pi * np.arange(n) / n
    ring = side[:, None] * (np.cos(t)[:, None] * stretch[:, None, None]) + across * np.sin(t)[:, None]
    outer, inner = (spine[:, None] + radius * ring for radius in radii)
    m = len(spine)
    return joined(
        [
            (outer.reshape(-1, 3), _grid_faces(m, n), 0),
            (inner.reshape(-1, 3), _grid_faces(m, n)[:, ::-1], 1),
            between(inner[0], outer[0], 2),
            between(outer[-1], inner[-1], 3),
        ],
        name=name,
        color=color,
    )


def between(one: Array, other: Array, surface: int, *, closed: bool = True) -> Piece:
    """Return the strip between two lines of as many points (N, 3): outside is left of `one` seen from `other`."""
    n = len(one)
    k = np.arange(n if closed else n - 1)
    after = (k + 1) % n
    triangles = np.concatenate([np.column_stack([k, after, k + n]), np.column_stack([after, after + n, k + n])])
    return np.concatenate([one, other]), triangles, surface


def level(flat: tuple[Array, Longs], height: float, surface: int, *, down: bool = False) -> Piece:
    """Return a flat triangulation at a height, facing up or down."""
    points, triangles = flat
    return np.column_stack([points, np.full(len(points), height)]), triangles[:, ::-1] if down else triangles, surface


def joined(pieces: Sequence[Piece], *, name: str, color: Color | None) -> Mesh:
    """Return the pieces as one part, welded where their lines coincide."""
    at = np.cumsum([0] + [len(points) for points, _, _ in pieces])
    return mend(
        Mesh.single(
            np.concatenate([points for points, _, _ in pieces]),
            np.concatenate([triangles + at[k] for k, (_, triangles, _) in enumerate(pieces)]),
            name=name,
            surface=np.concatenate([np.full(len(f), number, np.int32) for _, f, number in pieces]),
            color=color,
        )
    )[0]


def _grid_faces(m: int, n: int) -> Longs:
    """Return the triangles of m rings of n points, each ring closed."""
    i, k = (a.ravel() for a in np.meshgrid(np.arange(m - 1), np.arange(n), indexing="ij"))
    after = (k + 1) % n
    a, b, c, d = i * n + k, i * n + after, (i + 1) * n + after, (i + 1) * n + k
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
