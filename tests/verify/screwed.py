"""A plate with countersunk screws that are flush with it, in through holes over a block."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import Piece, between, box, circle, filled, joined, level
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part

CAMERA = Camera.from_focal((800, 600), 1500.0)
POSE = Rigid.look_at((60.0, -130.0, 210.0), (0.0, 0.0, 6.0))
RADIUS, HIGH, SIDES = 5.5, 12.0, 40
SCREWS = {"screw 1": (-25.0, -8.0), "screw 2": (6.0, 12.0), "screw 3": (27.0, -10.0)}
STEEL = (0.6, 0.6, 0.6)
_HOLE = [(1.0, 0.0), (0.52, 0.48), (0.52, HIGH / RADIUS)]  # radius and depth in radii of a head
_SCREW = [(0.98, 0.01), (0.5, 0.48), (0.5, 1.8)]


def _rings(at: tuple[float, float], profile: list[tuple[float, float]]) -> list[Array]:
    return [
        np.column_stack([circle(at, r * RADIUS, SIDES), np.full(SIDES, HIGH - depth * RADIUS)]) for r, depth in profile
    ]


def _inside(piece: Piece) -> Piece:
    return piece[0], piece[1][:, ::-1], piece[2]


def _plate() -> Mesh:
    corners = np.array([(-45, -30), (45, -30), (45, 30), (-45, 30)], float)
    holes = [_rings(at, _HOLE) for at in SCREWS.values()]
    pieces = [level(filled(corners, [hole[0][:, :2] for hole in holes]), HIGH, 1)]
    pieces.append(level(filled(corners, [hole[-1][:, :2] for hole in holes]), 0, 2, down=True))
    for hole in holes:
        pieces += [_inside(between(low, high, 10 + len(pieces))) for high, low in pairwise(hole)]
    low = np.column_stack([corners, np.zeros(4)])
    for side in ([0, 1], [1, 2], [2, 3], [3, 0]):
        pieces.append(between(low[side], low[side] + [0, 0, HIGH], 3 + side[0], closed=False))
    return joined(pieces, name="plate", color=STEEL)


def _screw(name: str) -> Mesh:
    rings = _rings(SCREWS[name], _SCREW)
    hexagon = np.column_stack([circle(SCREWS[name], 0.5 * RADIUS, 6), np.full(6, rings[0][0, 2])])
    bottom = hexagon - [0, 0, 0.5 * RADIUS]
    pieces = [between(low, high, 10 + k) for k, (high, low) in enumerate(pairwise(rings))]
    pieces += [level(filled(rings[0][:, :2], [hexagon[:, :2]]), rings[0][0, 2], 1)]
    pieces += [level(filled(bottom[:, :2]), bottom[0, 2], 2)]
    pieces += [level(filled(rings[-1][:, :2]), rings[-1][0, 2], 3, down=True)]
    for k in range(6):
        side = [k, (k + 1) % 6]
        pieces.append(_inside(between(bottom[side], hexagon[side], 20 + k, closed=False)))
    return joined(pieces, name=name, color=STEEL)


@cache
def screwed() -> Mesh:
    """Return plate, screws and block, all of one grey."""
    block = box((-40, -25, -20), (40, 25, 0), name="block", color=STEEL)
    return merge([_plate(), *(_screw(name) for name in SCREWS), block])


@cache
def part() -> Part:
    return Part.of(screwed())
