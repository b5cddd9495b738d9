"""The extents of world points, on a line, on a plane or in space, and refusals that state them."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from cadcam.arrays import Array, Longs
from cadcam.errors import DegenerateGeometry

COLLINEAR = 1e-5  # width over length below which points are on a line
COPLANAR = 1e-4  # thickness over length below which points are on a plane: 0.03 mm over 300 mm
_PLANE_KNOWS = 8  # degrees of freedom of a plane's homography


def extents(p_world: Array) -> Array:
    """Return the rms extents (3,) mm of points (N, 3) along their principal axes, largest first."""
    centred = p_world - p_world.mean(axis=0)
    s = np.linalg.svd(centred, compute_uv=False)
    return np.asarray(np.append(s, np.zeros(3 - len(s))) / np.sqrt(len(p_world)))


def flatness(p_world: Array) -> float:
    """Return thickness over length: 0 for points on a plane, about 1 for a cloud."""
    e = extents(p_world)
    return float(e[2] / e[0]) if e[0] > 0 else 0.0


def refuse_flat(p_world: Array, *, unknowns: int) -> None:
    """Raise `DegenerateGeometry` for points on a line, and for points on a plane if it cannot tell `unknowns` apart.

    Points (N, 2) of a plane are only checked for a line.
    """
    e = extents(p_world)
    if e[1] <= COLLINEAR * e[0]:
        raise DegenerateGeometry(
            f"the world points lie on a line (rms extents {_text(e)} mm, width by length {_ratio(e[1], e[0]):.2g}): "
            "the camera may turn about it; add points beside it"
        )
    if p_world.shape[1] == 3 and e[2] <= COPLANAR * e[0] and unknowns > _PLANE_KNOWS:
        raise DegenerateGeometry(
            f"the world points lie on a plane (rms extents {_text(e)} mm, thickness by length "
            f"{_ratio(e[2], e[0]):.2g}, {COPLANAR:g} needed): it determines at most {_PLANE_KNOWS} of the {unknowns} "
            "unknowns; fix the internals to get a pose, or add points at other heights"
        )


def spread_subset(p: Array, count: int) -> Longs:
    """Return the indices of `count` points (N, d) far from each other, the farthest from the rest first."""
    if len(p) <= count:
        return np.arange(len(p))
    distance = np.linalg.norm(p - p.mean(axis=0), axis=1)
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(p - p[chosen[-1]], axis=1))
    return np.array(chosen)


def triples(p: Array, q: Array, count: int) -> Longs:
    """Return up to `count` triples (T, 3) of indices of well-spread points, those of the largest image area first."""
    pool = spread_subset(np.column_stack([q / max(np.ptp(q), 1e-300), p / max(np.ptp(p), 1e-300)]), 8)
    index = np.array(list(combinations(pool, 3)))
    a, b = q[index[:, 1]] - q[index[:, 0]], q[index[:, 2]] - q[index[:, 0]]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return np.asarray(index[np.argsort(-area, kind="stable")[:count]])


def distinct(p: Array) -> int:
    """Return how many different rows p has."""
    return len(np.unique(p, axis=0))


def _ratio(small: float, large: float) -> float:
    return float(small / large) if large > 0 else 0.0


def _text(e: Array) -> str:
    return " x ".join(f"{x:.3g}" for x in e)
