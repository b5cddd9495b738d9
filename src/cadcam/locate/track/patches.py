"""Patches of a part's faces taken from one photo, and the pose that aligns them with another.

A patch is a small square of a photo, each of its samples with its point on the part's surface. In another photo it has
another brightness and contrast, because the lighting changes as the part turns:

    I(q(p_i)) = a + b look_i + r_i        q(p): the projection of point p at the pose, lens included

The pose minimises r over all patches (B. Lucas, T. Kanade, "An iterative image registration technique", IJCAI 1981,
over rigid motions), first on a strongly blurred photo. Patches that do not correlate, because they are hidden or
changed, are left out. The covariance follows from the residuals, with each patch as one correlated measurement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid, by_twist
from cadcam.image.profile import noise_of
from cadcam.locate.freedom import Freedom
from cadcam.locate.match.salient import corner_strength
from cadcam.locate.photo import Photo
from cadcam.render.view import Channel, Renderer, View

LEAST = 10  # fewest patches that determine a pose
_EXTENT, _MARGIN = 320, 8  # largest size of the part in px at which patches are compared; margin kept around it
_BLURS = (2.5, 1.0)  # px: coarse, fine
_ROUNDS, _SETTLED_PX = (5, 6), (0.3, 0.02)
_SAMPLES = np.stack(np.meshgrid(*[np.arange(-5.0, 6.0, 2.0)] * 2), axis=-1).reshape(-1, 2)  # px, the samples of a patch
_SPARSE = np.flatnonzero((np.abs(_SAMPLES) != 3).all(axis=1))  # those compared at the coarse level
_APART, _MOST = 9, 80  # px between patches; the most patches of one photo
_OVERLAP = (11 / _APART) ** 2  # factor by which patches that share pixels carry less information than separate ones
_INSIDE = 6  # px between a patch's centre and the outline or a bend of the surface
_BENT = 0.25  # largest difference of unit normals between neighbouring pixels of one face
_STRUCTURE = 1.0  # least slope in a patch's weaker direction, in sds of a pixel's noise, for it to be followed
_FACING = 0.2  # least cosine between normal and viewing direction
_ALIKE, _UNLIKE = 0.8, 0.5  # correlation of a patch that is found again; of one that is not
_SHARE = 0.5  # least share of the patches in view that must be found again
_SHIFTS = np.stack(np.meshgrid(*[np.arange(-16.0, 17.0, 4.0)] * 2), axis=-1).reshape(-1, 1, 2)  # px, tried in turn


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """The part's surroundings in a photo, reduced in size where they are large, and the camera of the reduced picture.

    layers: for each blur (H, W, 3): brightness and its slopes along x and y. noise: sd of a pixel of the photo.
    """

    camera: Camera
    layers: tuple[Picture, ...]
    noise: float

    @classmethod
    def of(cls, photo: Photo, corners: Array, camera_from_part: Rigid) -> Canvas | None:
        """Return the canvas around a part's corners (N, 3) mm; None where the photo hardly contains any of it."""
        q = photo.camera.project(camera_from_part @ corners)
        if not np.isfinite(q).all():
            return None
        size = np.array(photo.camera.size)
        low, high = (np.clip(ends, 0, size - 1) for ends in (q.min(axis=0), q.max(axis=0)))
        by = max(1, math.ceil(float((high - low).max()) / _EXTENT))
        first = np.maximum(np.floor(low) - _MARGIN * by, 0).astype(int)
        shape = (np.minimum(np.ceil(high) + _MARGIN * by, size).astype(int) - first) // by
        if shape.min() < 3 * _MARGIN:
            return None
        (x, y), (width, height) = first.tolist(), shape.tolist()
        gray = photo.gray[y : y + height * by, x : x + width * by]
        if by > 1:
            gray = gray.reshape(height, by, width, by).mean(axis=(1, 3), dtype=np.float32)
        camera = photo.camera.crop(x, y, (width * by, height * by)).resize((width, height))
        return cls(camera, tuple(_layers(gray, blur) for blur in _BLURS), noise_of(photo.gray))

    def sampled(self, level: int, q: Array) -> Array:
        """Return brightness and slopes (N, 3) at pixels q (N, 2); nan outside."""
        layers = self.layers[level]
        height, width, _ = layers.shape
        with np.errstate(invalid="ignore"):
            inside: Mask = np.all((q >= 0) & (q < np.array([width - 1, height - 1])), axis=1)
        whole = np.where(inside[:, None], q, 0.0).astype(np.int64)
        u, v = (q - whole).T[:, :, None]
        index, flat = whole[:, 1] * width + whole[:, 0], layers.reshape(-1, 3)
        upper, lower = flat[index], flat[index + width]
        upper = upper + u * (flat[index + 1] - upper)
        lower = lower + u * (flat[index + width + 1] - lower)
        out: Array = upper + v * (lower - upper)
        out[~inside] = np.nan
        return out


def _layers(gray: Picture, blur: float) -> Picture:
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(gray, blur, truncate=3.0, mode="nearest")
    dy, dx = np.gradient(smooth)
    return np.stack([smooth, dx, dy], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """P patches of n samples of a photo: p (P, n, 3) mm and normal (P, 3), both in part axes.

    looks: brightness, strongly blurred (P, m) at every other sample and finely (P, n) at all; of mean 0 and norm 1.
    """

    p: Array
    normal: Array
    looks: tuple[Array, Array]

    def __len__(self) -> int:
        return len(self.p)

    @classmethod
    def none(cls) -> Patches:
        """Return no patches, for a photo that does not show the part."""
        return cls(np.zeros((0, 1, 3)), np.zeros((0, 3)), (np.zeros((0, 1)), np.zeros((0, 1))))

    @classmethod
    def learned(cls, renderer: Renderer, canvas: Canvas, camera_from_part: Rigid) -> Patches:
        """Return the patches of a photo, taken at this pose, that can be followed."""
        view = renderer.render(canvas.camera, camera_from_part, channels=Channel.DEPTH | Channel.NORMAL)
        middle = _middles(canvas, view)
        q = middle[:, None] + _SAMPLES
        p = camera_from_part.inv @ _surface(canvas.camera, view, q)
        looks = [canvas.sampled(k, at.reshape(-1, 2))[:, 0].reshape(at.shape[:2]) for k, at in enumerate(_levels(q))]
        looks = [look - look.mean(axis=1, keepdims=True) for look in looks]
        sizes = [np.linalg.norm(look, axis=1, keepdims=True) for look in looks]
        kept = np.isfinite(p).all(axis=(1, 2)) & (np.minimum(*sizes)[:, 0] > 0)
        facing = view.normal[middle[:, 1], middle[:, 0]].astype(np.float64) @ camera_from_part.rotation
        coarse, fine = (look[kept] / size[kept] for look, size in zip(looks, sizes, strict=True))
        return cls(p[kept], facing[kept], (coarse, fine))

    def facing(self, camera_from_part: Rigid) -> Mask:
        """Return which patches (P,) face the camera."""
        sight = camera_from_part.origin - self.p[:, 0]
        facing: Mask = (sight * self.normal).sum(axis=1) > _FACING * np.linalg.norm(sight, axis=1)
        return facing


def _levels(samples: Array) -> tuple[Array, Array]:
    """Return the samples (P, n, ...) of the coarse and of the fine level."""
    return samples[:, _SPARSE], samples


def _middles(canvas: Canvas, view: View) -> npt.NDArray[np.int64]:
    """Return the pixels (P, 2) to centre patches on: within one face, with structure in all directions."""
    from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

    bends = [np.ptp([f(view.normal[..., k], 3) for f in (minimum_filter, maximum_filter)], axis=0) for k in range(3)]
    face = np.isfinite(view.depth) & (np.max(bends, axis=0) < _BENT)
    away = distance_transform_edt(np.pad(face, 1))[1:-1, 1:-1]
    strength = corner_strength(canvas.layers[-1][..., 0], int(np.ptp(_SAMPLES)) + 1)
    peak = (strength == maximum_filter(strength, _APART)) & (away > _INSIDE)
    y, x = np.nonzero(peak & (strength > (_STRUCTURE * canvas.noise) ** 2))
    best = np.argsort(-strength[y, x], kind="stable")
    found = np.column_stack([x, y])[best]
    chosen: list[int] = []
    for k, q in enumerate(found):
        if len(chosen) < _MOST and (np.abs(found[chosen] - q).max(axis=1) >= _APART).all():
            chosen.append(k)
    return found[chosen]


def _surface(camera: Camera, view: View, q: Array) -> Array:
    """Return the points (P, n, 3) mm, camera frame, seen at whole pixels q (P, n, 2); nan where none is."""
    x, y = np.moveaxis(q.astype(np.int64), 2, 0)
    inside = (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
    depth = view.depth[np.where(inside, y, 0), np.where(inside, x, 0)].astype(np.float64)
    rays = camera.unproject(q)
    return np.where((inside & np.isfinite(depth))[..., None], rays * (depth / rays[..., 2])[..., None], np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The pose world_from_part that aligns patches with a photo, its covariance (6, 6), and how many correlate."""

    world_from_part: Rigid
    covariance: Array
    found: int


def aligned(
    patches: Sequence[Patches],
    canvases: Sequence[Canvas | None],
    photos: Sequence[Photo],
    start: Rigid,
    freedom: Freedom,
) -> Alignment | None:
    """Return the pose near a start, some px off, at which patches are found again; None where too few are."""
    seen = [
        _Followed(one, canvas, photo.camera_from_world)
        for one, canvas, photo in zip(patches, canvases, photos, strict=True)
        if canvas is not None and len(one)
    ]
    if not seen:
        return None
    found = _settled(seen, start, freedom)
    return found or _settled(seen, _shifted(max(seen, key=lambda one: len(one.patches)), start), freedom)


class _Followed(NamedTuple):
    """Patches of one photo, another photo by the same camera, and camera_from_world."""

    patches: Patches
    canvas: Canvas
    place: Rigid


class _Residuals(NamedTuple):
    """Residuals r (P, n) of P patches in view, their Jacobian J (P, n, 6) by the twist, and correlations alike (P,).

    by_px (P, 2, 6): derivative of the first sample's pixel by the twist.
    """

    r: Array
    J: Array
    alike: Array
    by_px: Array


class _Update(NamedTuple):
    """A Gauss-Newton update: the new pose, the largest shift (px), the covariance, and the patches' correlations."""

    pose: Rigid
    moved_px: float
    covariance: Array
    alike: Array


def _settled(seen: Sequence[_Followed], pose: Rigid, freedom: Freedom) -> Alignment | None:
    """Return where Gauss-Newton converges, on the coarse and then on the fine level."""
    step = _Update(pose, np.inf, np.zeros((6, 6)), np.zeros(0))
    for level, (rounds, settled) in enumerate(zip(_ROUNDS, _SETTLED_PX, strict=True)):
        for _ in range(rounds):
            following = _stepped(seen, step.pose, freedom.at(step.pose), level)
            if following is None:
                return None
            step = following
            if step.moved_px < settled:
                break
    found = int(np.count_nonzero(step.alike > _ALIKE))
    return Alignment(step.pose, step.covariance, found) if found >= max(LEAST, _SHARE * len(step.alike)) else None


def _stepped(seen: Sequence[_Followed], pose: Rigid, B: Array, level: int) -> _Update | None:
    """Return the next step in the basis B; None where too few patches correlate."""
    rows = [_rows(*one, pose, level) for one in seen]
    r, J, alike, by_px = (np.concatenate([one[k] for one in rows]) for k in range(4))
    w = _weights(r, alike)
    n = int(np.count_nonzero(w))
    if n < LEAST:
        return None
    J = J @ B
    Jw = J * w[:, None, None]
    H, g = np.einsum("pni,pnj->ij", Jw, J, optimize=True), np.matmul(r[:, None], Jw)[:, 0]
    back = B @ np.linalg.pinv(H, hermitian=True)
    step = back @ g.sum(axis=0)
    covariance = back @ (g.T @ g) @ back.T * (_OVERLAP * n / max(n - len(H), 1))
    return _Update(pose @ Rigid.exp(step), float(np.abs(by_px @ step).max()), covariance, alike)


def _weights(r: Array, alike: Array) -> Array:
    """Return the weights of patches (P,), from their residuals; 0 for those that do not correlate."""
    own = np.mean(r**2, axis=1)
    counts = np.clip((alike - _UNLIKE) / (_ALIKE - _UNLIKE), 0.0, 1.0)
    return np.asarray(counts / (own + (np.median(own) if len(own) else 0.0) + 1e-12))


def _rows(patches: Patches, canvas: Canvas, place: Rigid, pose: Rigid, level: int) -> _Residuals:
    """Return residuals and Jacobian of the patches in view, with each one's a and b eliminated by projection."""
    camera_from_part = place @ pose
    facing, every = patches.facing(camera_from_part), _levels(patches.p)[level]
    n, p = every.shape[1], every[facing].reshape(-1, 3)
    q, by_p = canvas.camera.project_with_jacobian(camera_from_part @ p)
    values = canvas.sampled(level, q)
    J = np.matmul(values[:, None, 1:], by_p)[:, 0] @ camera_from_part.rotation
    J = by_twist(p, J).reshape(-1, n, 6)
    by_px = by_twist(p[::n, None], by_p[::n] @ camera_from_part.rotation)
    brightness, look = values[:, 0].reshape(-1, n), patches.looks[level][facing]
    whole = np.isfinite(brightness).all(axis=1)
    brightness, look, J, by_px = brightness[whole], look[whole], J[whole], by_px[whole]
    brightness = brightness - brightness.mean(axis=1, keepdims=True)
    along = (brightness * look).sum(axis=1)
    J = J - J.mean(axis=1, keepdims=True)
    J -= look[:, :, None] * np.matmul(look[:, None], J)
    alike = along / np.maximum(np.linalg.norm(brightness, axis=1), 1e-9)
    return _Residuals(along[:, None] * look - brightness, J, alike, by_px)


def _shifted(seen: _Followed, start: Rigid) -> Rigid:
    """Return the start shifted parallel to the image plane to where most patches correlate at the coarse level."""
    patches, canvas, place = seen
    camera_from_part = place @ start
    p = camera_from_part @ _levels(patches.p)[0]
    q = np.rint(np.nan_to_num(canvas.camera.project(p.reshape(-1, 3)), nan=-1.0) + _SHIFTS)
    inside = ((q >= 0) & (q < canvas.camera.size)).all(axis=2)
    x, y = np.moveaxis(np.where(inside[..., None], q, 0).astype(np.int64), 2, 0)
    values = np.where(inside, canvas.layers[0][y, x, 0], 0.0).reshape(len(_SHIFTS), *p.shape[:2])
    values -= values.mean(axis=2, keepdims=True)
    alike = (values * patches.looks[0]).sum(axis=2) / (np.linalg.norm(values, axis=2) + 1e-9)
    best = _SHIFTS[int(np.argmax(np.maximum(alike, 0.0).sum(axis=1))), 0]
    aside = best * float(np.mean(p[..., 2])) / np.array([canvas.camera.fx, canvas.camera.fy])
    return place.inv @ Rigid(camera_from_part.rotation, camera_from_part.translation + np.append(aside, 0.0))
