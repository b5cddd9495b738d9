"""The approximate image of large faces through a distorting lens: triangles in pixels, and a bound of their error.

Edges are straight in the plane u = (x, y)/z. There they are halved until the lens bends no piece by more than half of
that bound from its chord, and only then are vertices distorted. Lens and camera are `Camera`'s own, in float64. Drawing
the triangles `REACH_PX` wider than they are covers every pixel of the faces; these are then tested exactly. Faces with
short edges, of which there may be millions, need none of this: they are drawn as they are (`render.gl.bend`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.camera.camera import Camera
from cadcam.render.lines.clip import WIDEST, ViewVolume

REACH_PX = 8.0
NEAR_SHARE = 1e-6  # of the farthest depth: the near plane
_STRAIGHT_PX = 4.0  # shorter edges are not tested for bending
_LONGEST_PX = 512.0  # of an edge that is not halved
_FARTHEST = 1e6  # |u| beyond this is less than 0.2 seconds of arc from the focal plane
_MARGIN_PX = 2.0
_ROUNDS = 96  # an edge of 1e9 px takes 25 halvings per side


def pieces(camera: Camera, frustum: ViewVolume, p: Array) -> tuple[Array, Longs]:
    """Return the image of triangles p (N, 3, 3), mm in the camera frame.

    It consists of triangles (M, 3, 2) in distorted pixels, in the order of the N that they belong to (M,).
    """
    corners, owner = _in_front(p, frustum.near)
    return _halved(camera, frustum, corners[..., :2] / corners[..., 2:], owner)


def frustum_of(camera: Camera, near: float) -> ViewVolume:
    """Return a frustum of all that the camera images, including the last third of a degree that lines leave out.

    `near` is the depth in mm of its near plane.
    """
    frustum = ViewVolume.of(camera, near=near, margin_px=_MARGIN_PX)
    low = np.where(frustum.low <= -WIDEST, -_FARTHEST, frustum.low)
    return replace(frustum, low=low, high=np.where(frustum.high >= WIDEST, _FARTHEST, frustum.high))


def _halved(camera: Camera, frustum: ViewVolume, u: Array, owner: Longs) -> tuple[Array, Longs]:
    """Return pixels (M, 3, 2) and owners of triangles u (N, 3, 2), halved as often as their edges require."""
    kept: list[tuple[Array, Longs]] = [(np.zeros((0, 3, 2)), np.zeros(0, np.int64))]
    for _ in range(_ROUNDS):
        near_picture = ~_outside(frustum, u)
        u, owner = u[near_picture], owner[near_picture]
        if not len(u):
            break
        q = _image(camera, frustum, u)
        halve = _to_halve(camera, frustum, u, q)
        done = ~halve.any(axis=1)
        kept.append((q[done], owner[done]))
        u, owner = _halves(u[~done], np.where(halve[~done], _length(q[~done]), -1.0)), np.tile(owner[~done], 2)
    order = np.argsort(np.concatenate([o for _, o in kept]), kind="stable")
    return np.concatenate([q for q, _ in kept])[order], np.concatenate([o for _, o in kept])[order]


def _to_halve(camera: Camera, frustum: ViewVolume, u: Array, q: Array) -> Mask:
    """Return which edges (N, 3), k from corner k to the next, are too long or bent; symmetric in their ends."""
    length = _length(q)
    beyond = np.sum(u * u, axis=-1) >= frustum.radius**2
    at_rim = beyond | np.roll(beyond, -1, axis=1)
    halve: Mask = (length > _LONGEST_PX) | (at_rim & (length > REACH_PX))
    index = np.nonzero(~halve & ~at_rim & (length > _STRAIGHT_PX))
    a, b = u[index], np.roll(u, -1, axis=1)[index]
    qa, chord = q[index], (np.roll(q, -1, axis=1) - q)[index]
    middle = _middle(a, b)
    for at in (middle, _middle(a, middle), _middle(middle, b)):  # an S-shaped edge passes through its chord's middle
        off = _image(camera, frustum, at) - qa
        across = off[:, 0] * chord[:, 1] - off[:, 1] * chord[:, 0]
        halve[index] |= np.abs(across) > REACH_PX / 2 * length[index]
    return halve


def _halves(u: Array, length: Array) -> Array:
    """Return triangles (2N, 3, 2): each u (N, 3, 2) halved at its longest edge by `length` (N, 3)."""
    row, k = np.arange(len(u)), np.argmax(length, axis=1)
    a, b, c = u[row, k], u[row, (k + 1) % 3], u[row, (k + 2) % 3]
    middle = _middle(a, b)
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _middle(a: Array, b: Array) -> Array:
    """Return the intersection of the direction half way between those of a and b (N, 2) with the plane u; symmetric."""
    wa, wb = (1 / np.sqrt(1 + np.sum(u * u, axis=-1, keepdims=True)) for u in (a, b))
    return np.asarray((a * wa + b * wb) / (wa + wb))


def _image(camera: Camera, frustum: ViewVolume, u: Array) -> Array:
    """Return pixels of u (..., 2); beyond the valid radius the image is continued outwards in proportion, unfolded."""
    radius = np.sqrt(np.sum(u * u, axis=-1))
    shrink = np.minimum(1.0, frustum.radius * (1 - 1e-9) / np.maximum(radius, 1e-300))
    inner = u * shrink[..., None]
    m = camera.lens.project(np.concatenate([inner, np.ones((*u.shape[:-1], 1))], axis=-1))
    return camera.pixel_of(m / shrink[..., None])


def _outside(frustum: ViewVolume, u: Array) -> Mask:
    """Return which triangles (N, 3, 2) lie wholly beyond one side of all that the camera images."""
    highest, lowest = u.max(axis=1), u.min(axis=1)
    out: Mask = np.any((highest < frustum.low) | (lowest > frustum.high), axis=1)
    if np.isfinite(frustum.radius):
        towards = u.mean(axis=1)
        towards /= np.maximum(np.linalg.norm(towards, axis=1), 1e-300)[:, None]
        out |= (np.einsum("nki,ni->nk", u, towards) > frustum.radius).all(axis=1)
    return np.asarray(out)


def _in_front(p: Array, near: float) -> tuple[Array, Longs]:
    """Return the parts (M, 3, 3) of triangles p (N, 3, 3) with z >= near, and the triangle of each."""
    inside = p[..., 2] >= near
    count = inside.sum(axis=1)
    whole, one, two = (np.flatnonzero(count == n) for n in (3, 1, 2))
    tip, odd = np.argmax(inside[one], axis=1), np.argmin(inside[two], axis=1)
    a, b, c = (p[one, (tip + k) % 3] for k in range(3))
    lone = np.stack([a, _cut(a, b, near), _cut(a, c, near)], axis=1)
    o, b, c = (p[two, (odd + k) % 3] for k in range(3))
    pair = [np.stack([b, c, _cut(c, o, near)], axis=1), np.stack([b, _cut(c, o, near), _cut(b, o, near)], axis=1)]
    return np.concatenate([p[whole], lone, *pair]), np.concatenate([whole, one, two, two])


def _cut(inside: Array, outside: Array, near: float) -> Array:
    """Return the intersections of the edges from `inside` to `outside` (N, 3) with z = near."""
    t = (inside[:, 2] - near) / (inside[:, 2] - outside[:, 2])
    out = inside + t[:, None] * (outside - inside)
    out[:, 2] = near
    return out


def _length(q: Array) -> Array:
    d = np.roll(q, -1, axis=1) - q
    return np.asarray(np.hypot(d[..., 0], d[..., 1]))
