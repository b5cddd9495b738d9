"""A machined bracket: base and wall, holes, a filleted inner corner, a boss with a bore."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import Piece, arc, between, circle, filled, joined
from cadcam.errors import BadValue

# mm; x along the base, y across, z up; the wall stands at x = 0, its boss on the side of -x
LENGTH, WIDTH, HEIGHT = 120.0, 80.0, 60.0
BASE, WALL = 12.0, 14.0
CORNER, SHOULDER, FILLET = 12.0, 18.0, 10.0
HOLE, HOLES = 4.5, ((52.0, 16.0), (52.0, 64.0), (104.0, 16.0), (104.0, 64.0))
BORE, BOSS, BOSS_HEIGHT, BOSS_FILLET = 9.0, 16.0, 9.0, 3.0
CENTRE = (40.0, 36.0)  # y, z of the bore


def machined_bracket(*, sides: int = 48) -> Mesh:
    """Return a watertight bracket of 129 x 80 x 60 mm (120 and a boss of 9), one part, every smooth surface numbered.

    Base plate with four through holes and rounded corners; wall with rounded shoulders and a bored boss; a fillet in
    the inner corner and one (a torus) around the boss. Planes, cylinders and the torus meet where a B-rep has edges.
    `sides` is the number of sides of a full circle, a multiple of 4. Raises `BadValue`.
    """
    if sides < 12 or sides % 4:
        raise BadValue("sides", sides, "a multiple of 4, at least 12")
    pieces = [*_base(sides), *_wall(sides), *_boss(sides), *_sides(sides)]
    return joined(pieces, name="bracket", color=(0.72, 0.73, 0.75))


def _base(n: int) -> list[Piece]:
    """Return top and bottom of the base, its rounded corners, its end and its holes."""
    q = n // 4
    low = arc((LENGTH - CORNER, CORNER), CORNER, -90, 0, q)
    high = arc((LENGTH - CORNER, WIDTH - CORNER), CORNER, 0, 90, q)
    holes = [circle(centre, HOLE, n) for centre in HOLES]
    start = WALL + FILLET
    top = filled(np.concatenate([[[start, 0]], low, high, [[start, WIDTH]]]), holes)
    bottom = filled(np.concatenate([[[0, 0]], low, high, [[0, WIDTH]]]), holes)
    pieces: list[Piece] = [
        (_xy(top[0], BASE), top[1], 0),
        (_xy(bottom[0], 0), bottom[1][:, ::-1], 1),
        between(_xy(low, 0), _xy(low, BASE), 2, closed=False),
        between(_xy(high, 0), _xy(high, BASE), 3, closed=False),
        between(_xy(np.array([low[-1], high[0]]), 0), _xy(np.array([low[-1], high[0]]), BASE), 4, closed=False),
    ]
    return pieces + [between(_xy(hole, BASE), _xy(hole, 0), 5 + k) for k, hole in enumerate(holes)]


def _wall(n: int) -> list[Piece]:
    """Return both faces of the wall, open for boss and bore, its rounded shoulders and its top."""
    q = n // 4
    right = arc((WIDTH - SHOULDER, HEIGHT - SHOULDER), SHOULDER, 0, 90, q)
    left = arc((SHOULDER, HEIGHT - SHOULDER), SHOULDER, 90, 180, q)
    foot = BASE + FILLET
    inner = filled(np.concatenate([[[0, foot], [WIDTH, foot]], right, left]), [circle(CENTRE, BORE, n)])
    outer = filled(np.concatenate([[[0, 0], [WIDTH, 0]], right, left]), [circle(CENTRE, BOSS + BOSS_FILLET, n)])
    pieces: list[Piece] = [(_yz(inner[0], WALL), inner[1], 20), (_yz(outer[0], 0), outer[1][:, ::-1], 21)]
    for surface, line in ((22, right), (23, np.array([right[-1], left[0]])), (24, left)):
        pieces.append(between(_yz(line, 0), _yz(line, WALL), surface, closed=False))
    return pieces


def _boss(n: int) -> list[Piece]:
    """Return the torus at the foot of the boss, its cylinder, its face and the bore."""
    turn = np.radians(np.linspace(0, 90, max(n // 8, 3) + 1))
    rings = [_yz(circle(CENTRE, BOSS + BOSS_FILLET * (1 - np.sin(t)), n), -BOSS_FILLET * (1 - np.cos(t))) for t in turn]
    pieces = [between(one, other, 30) for one, other in pairwise(rings)]
    end = -BOSS_HEIGHT
    face = filled(circle(CENTRE, BOSS, n), [circle(CENTRE, BORE, n)])
    return [
        *pieces,
        between(rings[-1], _yz(circle(CENTRE, BOSS, n), end), 31),
        (_yz(face[0], end), face[1][:, ::-1], 32),
        between(_yz(circle(CENTRE, BORE, n), end), _yz(circle(CENTRE, BORE, n), WALL), 33),
    ]


def _sides(n: int) -> list[Piece]:
    """Return the two flat sides and the fillet between base and wall."""
    curve = arc((WALL + FILLET, BASE + FILLET), FILLET, -90, -180, n // 4)
    outline = np.concatenate(
        [
            [[0, 0], [LENGTH - CORNER, 0], [LENGTH - CORNER, BASE]],
            curve,
            [[WALL, HEIGHT - SHOULDER], [0, HEIGHT - SHOULDER]],
        ]
    )
    points, faces = filled(outline)
    return [
        (_xz(points, 0), faces, 40),
        (_xz(points, WIDTH), faces[:, ::-1], 41),
        between(_xz(curve, 0), _xz(curve, WIDTH), 42, closed=False),
    ]


def _xy(flat: Array, z: float) -> Array:
    return np.column_stack([flat, np.full(len(flat), z)])


def _xz(flat: Array, y: float) -> Array:
    return np.column_stack([flat[:, 0], np.full(len(flat), y), flat[:, 1]])


def _yz(flat: Array, x: float) -> Array:
    return np.column_stack([np.full(len(flat), x), flat])
