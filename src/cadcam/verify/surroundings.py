"""What lies on both sides of an edge, and how bright it should be: whether an edge ought to show is a matter of light.

The brightness of a matt surface follows from its orientation: under distant lights, however many, it is to 1 % a
quadratic form of the normal (R. Ramamoorthi and P. Hanrahan, J. Opt. Soc. Am. A 18, 2001). Its nine coefficients, and a
gain for each colour of the model, are fitted to the photo itself, robustly; shadows and what is not where the model has
it are strays. Edges between the same two surfaces have contrast, or lack it, together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import Channel
from cadcam.verify.sightlines import Sightlines

Longs = npt.NDArray[np.int64]
FAINT = 0.02  # contrast below which an edge may well not show
_ASIDE_PX = 1.5  # where the sides are looked at: twins are farther apart than this
_EVERY = 5  # px between the pixels that the light is fitted to
_ROUNDS = 8
_PRIOR = 0.3  # sigma of the light's coefficients before anything is seen
_LEAST_SCALE = 0.005  # brightness: a surface is never better known
_NORMALS, _FULL = (
    10.0,
    20,
)  # steps to a unit normal's component; pixels (of those looked at) of a surface that counts full
_ALIKE = 0.3  # distance of normals (about rad) up to which surfaces are taken to be lit alike


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What lies beside N places.

    normal (N, 2, 3): of the surfaces before and after the place along its normal, in the part frame, zero where there
    is nothing of the part; part, color (N, 2): the numbers of their part and of their paint, -1 for nothing; contrast
    (N,): by how much the brightness should at least change from one to the other, the light being known as well as it
    is.
    """

    normal: Array
    part: Ids
    color: Ids
    contrast: Array


def surroundings(part: Part, photos: Sequence[Photo], world_from_part: Rigid, lines: Sightlines) -> Surroundings:
    """Return what lies beside each place, the part being at this pose, in the light that the photos show."""
    n = len(lines)
    normals, contrast = np.zeros((n, 2, 3)), np.zeros(n)
    parts, colors = np.full((n, 2), -1, np.int32), np.full((n, 2), -1, np.int32)
    renderer = open_renderer(part.scene)
    paint = _paint(part)
    for i, photo in enumerate(photos):
        camera_from_part = photo.viewpoint.camera_from_world @ world_from_part
        view = renderer.render(photo.camera, camera_from_part, channels=Channel.NORMAL | Channel.FACE)
        normal = view.normal.astype(np.float64) @ camera_from_part.rotation
        color = np.where(view.face >= 0, paint[np.maximum(view.face, 0)], -1).astype(np.int32)
        light = _fitted_light(photo.gray.astype(np.float64), normal, color)
        rows = np.flatnonzero(lines.photo == i)
        for side, sign in enumerate((-1.0, 1.0)):
            q = np.rint(lines.q[rows] + sign * _ASIDE_PX * lines.normal[rows]).astype(np.int64)
            x, y = np.clip(q, 0, np.array(photo.camera.size) - 1).T
            normals[rows, side], colors[rows, side] = normal[y, x], color[y, x]
            face = view.face[y, x]
            parts[rows, side] = np.where(face >= 0, part.scene.mesh.part[np.maximum(face, 0)], -1)
        contrast[rows] = light.least_contrast(normals[rows], colors[rows])
    return Surroundings(normals, parts, colors, contrast)


def alike(normal: Array, color: Ids) -> Longs:
    """Return the number (E,) of the group of each edge by its two sides: normals (E, 2, 3), colours (E, 2)."""
    group = np.full(len(normal), -1, np.int64)
    for i in range(len(normal)):
        if group[i] >= 0:
            continue
        same = np.zeros(len(normal), bool)
        for order in ([0, 1], [1, 0]):
            close = np.linalg.norm(normal - normal[i, order], axis=2).max(axis=1) <= _ALIKE
            same |= close & (color == color[i, order]).all(axis=1)
        group[same & (group < 0)] = group.max() + 1
    return group


@dataclass(frozen=True, slots=True, eq=False)
class _Light:
    """Brightness of surfaces: form (9,) with its covariance, a gain for each colour, and of what is no surface."""

    form: Array
    covariance: Array
    gain: dict[int, float]
    nothing: float

    def least_contrast(self, normal: Array, color: Ids) -> Array:
        """Return the brightness (N,) between two surfaces, normals (N, 2, 3) and colours (N, 2), less its sigma."""
        gain = np.array([[self.gain.get(int(c), 0.0) for c in pair] for pair in color]).reshape(-1, 2)
        by = gain[..., None] * np.stack([_basis(normal[:, 0]), _basis(normal[:, 1])], axis=1)
        empty = np.where(color < 0, self.nothing, 0.0)
        change = by[:, 1] - by[:, 0]
        value = change @ self.form + empty[:, 1] - empty[:, 0]
        sigma = np.sqrt(np.einsum("ni,ij,nj->n", change, self.covariance, change))
        return np.asarray(np.maximum(np.abs(value) - sigma, 0.0))


def _fitted_light(gray: Array, normal: Array, color: Ids) -> _Light:
    """Return the light that explains the photo (H, W) with these normals (H, W, 3) and colours (H, W).

    Every surface counts once, however large it is: its pixels err together.
    """
    few = slice(None, None, _EVERY)
    g, n, c = gray[few, few].ravel(), normal[few, few].reshape(-1, 3), color[few, few].ravel()
    nothing = float(np.median(g[c < 0])) if (c < 0).any() else 0.5
    g, n, c, weight = _by_surface(g[c >= 0], n[c >= 0], c[c >= 0])
    gain = {int(k): 1.0 for k in np.unique(c)}
    A, form, covariance, robust = _basis(n), np.zeros(9), np.eye(9), np.ones(len(g))
    for _ in range(_ROUNDS if len(g) else 0):
        own = np.array([gain[int(k)] for k in c])
        r = g - own * (A @ form)
        scale = max(1.4826 * float(np.median(np.abs(r))), _LEAST_SCALE)
        robust = np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(r), 1e-12)) if form.any() else robust
        B = A * own[:, None]
        W = weight * robust
        covariance = np.linalg.inv(B.T @ (B * W[:, None]) / scale**2 + np.eye(9) / _PRIOR**2)
        form = covariance @ (B.T @ (W * g)) / scale**2
        seen = A @ form
        for k in gain:
            of = c == k
            power = float((W[of] * seen[of] ** 2).sum())
            gain[k] = float((W[of] * seen[of] * g[of]).sum()) / power if power > 0 else 1.0
    return _Light(form, covariance, gain, nothing)


def _by_surface(g: Array, n: Array, c: Ids) -> tuple[Array, Array, Ids, Array]:
    """Return brightness, normal, colour and weight of surfaces: pixels of one colour and about one normal."""
    key = np.column_stack([np.rint(n * _NORMALS), c]).astype(np.int64)
    _, first, at, count = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)
    at = at.reshape(-1)
    order = np.argsort(at, kind="stable")
    middle = np.array([np.median(part) for part in np.split(g[order], np.cumsum(count)[:-1])]) if len(g) else g
    return middle, n[first], c[first], np.minimum(count / _FULL, 1.0)


def _basis(normal: Array) -> Array:
    """Return (N, 9) the terms of a quadratic form of unit normals (N, 3) on the sphere."""
    x, y, z = normal.T
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], axis=1)


def _paint(part: Part) -> Ids:
    """Return the number (F,) of each face's colour, equal colours having one."""
    scene = part.scene
    _, number = np.unique(np.round(scene.colors, 3), axis=0, return_inverse=True)
    return number.reshape(-1)[scene.paint].astype(np.int32)
